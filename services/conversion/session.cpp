#include "services/conversion/session.hpp"

#include <spdlog/spdlog.h>

#include <cmath>
#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "services/conversion/spec_messages.hpp"

namespace pleat::conversion {
namespace {

void check_size(double vertices, std::int64_t limit, const char* what) {
  if (vertices <= static_cast<double>(limit)) return;
  throw Error(ErrorCode::kResourceExhausted, std::string(what) + ": about " +
                                                 std::to_string(static_cast<std::int64_t>(vertices)) +
                                                 ", more than this service's limit of " + std::to_string(limit));
}

/// Everything that decides a representation; ranges do not.
std::string key_of(const Topology& coarse, const Topology* fine, v1::Representation representation) {
  representation.clear_input();
  representation.clear_output();
  return topology_hash(coarse) + (fine != nullptr ? topology_hash(*fine) : "") + representation.SerializeAsString();
}

/// The ranges of a frame, once for each frame of the window.
ChannelRanges repeated(const ChannelRanges& ranges, int times) {
  ChannelRanges result;
  result.limit = ranges.limit;
  for (int t = 0; t < times; ++t) {
    result.offset.insert(result.offset.end(), ranges.offset.begin(), ranges.offset.end());
    result.scale.insert(result.scale.end(), ranges.scale.begin(), ranges.scale.end());
  }
  return result;
}

ChannelRanges first_channels(ChannelRanges ranges, std::int64_t count) {
  if (static_cast<std::int64_t>(ranges.channels()) <= count) return ranges;
  ranges.offset.resize(static_cast<std::size_t>(count));
  ranges.scale.resize(static_cast<std::size_t>(count));
  return ranges;
}

std::string in_words(const std::vector<std::int64_t>& shape) {
  std::string text;
  for (const std::int64_t extent : shape) text += (text.empty() ? "" : " x ") + std::to_string(extent);
  return text;
}

}  // namespace

Session::Session(const v1::ConversionSetup& setup, const SessionLimits& limits, RepresentationCache& cache,
                 v1::Tensor::DType dtype)
    : dtype_(dtype) {
  if (!setup.has_representation()) throw_invalid_argument("open.setup.representation: missing");
  const v1::Representation& wanted = setup.representation();
  const RepresentationSpec spec = spec_from(wanted, limits.max_texels);
  const Topology coarse = from_message(setup.coarse(), "open.setup.coarse");
  Topology fine;
  const bool has_fine = setup.has_fine() && setup.fine().faces_size() > 0;
  if (has_fine) {
    fine = from_message(setup.fine(), "open.setup.fine");
    check_size(static_cast<double>(fine.vertex_count()), limits.max_vertices,
               "open.setup.fine: vertices of the fine mesh");
  } else {
    check_size(static_cast<double>(coarse.vertex_count()) * std::pow(4.0, spec.subdivision.rounds), limits.max_vertices,
               "open.setup: vertices of the fine mesh");
  }
  representation_ = cache.get(
      key_of(coarse, has_fine ? &fine : nullptr, wanted),
      [&]() -> std::shared_ptr<const Representation> {
        return make_representation(coarse, spec, has_fine ? &fine : nullptr);
      },
      &was_cached_);
  const Representation& r = *representation_;
  input_ = repeated(ranges_from(wanted.input(), r.input_channels().size(), "open.setup: input ranges"), spec.window);
  output_ = ranges_from(wanted.output(), r.answer_channels().size(), "open.setup: output ranges");
  frames_.resize(static_cast<std::size_t>(spec.window));
  spdlog::info("session: {} coarse and {} fine vertices, {} to {} values, {} frames at once{}", coarse.vertex_count(),
               r.fine().vertex_count(), in_words(r.input_shape()), in_words(r.answer_shape()), spec.window,
               was_cached_ ? ", maps from the cache" : "");
}

void Session::describe(bool with_fine, v1::ConversionOpened* opened) const {
  const Representation& r = *representation_;
  const auto input = r.input_shape(), answer = r.answer_shape();
  for (const std::int64_t extent : input) opened->add_input_shape(static_cast<std::uint32_t>(extent));
  for (const std::int64_t extent : answer) opened->add_answer_shape(static_cast<std::uint32_t>(extent));
  if (input.size() == 3) {
    opened->set_coarse_width(static_cast<std::uint32_t>(input[2]));
    opened->set_coarse_height(static_cast<std::uint32_t>(input[1]));
    opened->set_fine_width(static_cast<std::uint32_t>(answer[2]));
    opened->set_fine_height(static_cast<std::uint32_t>(answer[1]));
  }
  if (!r.constants().shape.empty()) to_message(r.constants(), opened->mutable_constants());
  opened->set_dtype(r.fits_half() ? v1::Tensor::DTYPE_FLOAT16 : v1::Tensor::DTYPE_FLOAT32);
  if (!with_fine) return;
  *opened->mutable_fine() = to_message(r.fine());
  const auto& features = r.subdivision().feature_vertices;
  opened->mutable_feature_vertices()->Add(features.begin(), features.end());
}

void Session::add_obstacles(const google::protobuf::RepeatedPtrField<v1::ObstacleShape>& shapes) {
  if (!representation_->reads_obstacles()) return;
  for (const auto& shape : shapes) {
    obstacles_.push_back(from_message(shape, "open.obstacles[" + std::to_string(obstacles_.size()) + "]"));
  }
  field_.emplace(obstacles_);
}

void Session::encode(const v1::ToImageRequest& request, v1::ImageFrame* response) {
  const Eigen::Index vertices = representation_->coarse().vertex_count();
  if (request.earlier_size() + 1 != static_cast<int>(frames_.size())) {
    throw_invalid_argument("earlier: " + std::to_string(request.earlier_size()) + " frames, the representation reads " +
                           std::to_string(frames_.size() - 1) + " before the newest");
  }
  for (int t = 0; t < request.earlier_size(); ++t) {
    frames_[static_cast<std::size_t>(t)] = from_message(request.earlier(t), vertices, "earlier");
  }
  Frame& newest = frames_.back();
  newest = from_message(request.frame(), vertices, "frame");
  const RigidTransform alignment = representation_->align(newest.positions);
  if (field_) field_->update(obstacles_from_messages(request.obstacles(), obstacles_, "obstacles"));
  representation_->encode(frames_, alignment, input_tensor_, field_ ? &*field_ : nullptr);
  response->set_out_of_range(static_cast<std::uint32_t>(normalize(input_, input_tensor_)));
  response->set_index(newest.index);
  response->set_time_s(newest.time_s);
  to_payload(input_tensor_, dtype_, response->mutable_image());
  *response->mutable_alignment() = to_message(alignment);
}

void Session::decode(const v1::ImageFrame& request, v1::MeshFrame* response) {
  // Values that are not finite make positions that are not, which decode() refuses.
  from_payload(request.image(), "frame.image", &answer_);
  const RigidTransform alignment = from_message(request.alignment(), "frame.alignment");
  // A network may answer the first channels alone, where they are all that positions need.
  denormalize(first_channels(output_, answer_.shape[0]), answer_);
  Positions coarse;
  if (request.has_coarse()) {
    coarse = positions_from_message(request.coarse(), representation_->coarse().vertex_count(), "frame.coarse");
  }
  representation_->decode(answer_, coarse, alignment, positions_);
  v1::Frame* fine = response->mutable_fine();
  fine->set_index(request.index());
  fine->set_time_s(request.time_s());
  to_message(positions_, fine->mutable_positions());
  *response->mutable_stage_times() = request.stage_times();
}

}  // namespace pleat::conversion
