#include "services/conversion/geometry_image/geometry_image.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"

namespace pleat::conversion {
GeometryImage::GeometryImage(const Topology& coarse, Subdivision subdivision, const RepresentationSpec& spec)
    : spec_(spec),
      coarse_(coarse),
      subdivision_(std::move(subdivision)),
      map_(coarse_, subdivision_.fine, std::get<GeometryImageSpec>(spec.kind).image) {
  std::get<GeometryImageSpec>(spec_.kind).image = map_.spec();
}

std::vector<std::int64_t> GeometryImage::input_shape() const {
  return {static_cast<std::int64_t>(input_channels().size()), map_.coarse_height(), map_.coarse_width()};
}
std::vector<std::int64_t> GeometryImage::answer_shape() const {
  return {static_cast<std::int64_t>(answer_channels().size()), map_.fine_height(), map_.fine_width()};
}
std::vector<std::string> GeometryImage::input_channels() const { return frame_channel_names(); }
std::vector<std::string> GeometryImage::answer_channels() const { return frame_channel_names(); }

void GeometryImage::encode(std::span<const Frame> frames, const RigidTransform& alignment, Tensor& input,
                           ObstacleField*) const {
  if (static_cast<int>(frames.size()) != spec_.window) {
    throw_invalid_argument("window: " + std::to_string(frames.size()) + " frames, the representation has " +
                           std::to_string(spec_.window));
  }
  const std::vector<std::int64_t> shape = input_shape();
  const auto values = static_cast<std::size_t>(shape[0]) * coarse_texels();
  input.shape = shape;
  input.shape[0] *= spec_.window;
  if (input.channels.size() != static_cast<std::size_t>(input.shape[0])) {
    input.channels.clear();
    for (const Frame& frame : frames) {
      const auto age = static_cast<std::size_t>(&frames.back() - &frame);
      for (const std::string& name : input_channels()) {
        input.channels.push_back(age == 0 ? name : name + "_" + std::to_string(age));
      }
    }
  }
  input.values.resize(values * frames.size());
  for (std::size_t t = 0; t < frames.size(); ++t) encode_frame(frames[t], alignment, input.values.data() + t * values);
}

void GeometryImage::encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const {
  map_.coarse_image(frame, alignment, planes);
}

void GeometryImage::target(const Frame&, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const {
  map_.fine_image(fine, alignment, answer);
}

void GeometryImage::decode(const Tensor& answer, const Positions&, const RigidTransform& alignment,
                           Positions& fine) const {
  map_.to_mesh(answer, alignment, fine);
}

void GeometryImage::answer_axes(const Positions&, const RigidTransform&, Tensor& axes) const { axes = {}; }

void GeometryImage::base(const Positions&, const RigidTransform&, Positions& fine) const {
  fine = subdivision_.fine.rest_positions;
}

std::size_t GeometryImage::size() const {
  return static_cast<std::size_t>(fine().vertex_count()) + fine_texels() + constants_.values.size();
}

void GeometryImage::check_answer(const Tensor& answer, std::int64_t channels) const {
  if (answer.shape == std::vector<std::int64_t>{channels, map_.fine_height(), map_.fine_width()} &&
      answer.values.size() == static_cast<std::size_t>(channels) * fine_texels()) {
    return;
  }
  throw_invalid_argument("fine image: expected (" + std::to_string(channels) + ", " +
                         std::to_string(map_.fine_height()) + ", " + std::to_string(map_.fine_width()) + ")");
}

void GeometryImage::shape_answer(Tensor& answer) const {
  answer.shape = answer_shape();
  answer.channels = answer_channels();
  answer.values.resize(static_cast<std::size_t>(answer.shape[0]) * fine_texels());
}

std::vector<std::string> PositionImage::input_channels() const { return {"position_x", "position_y", "position_z"}; }

void PositionImage::encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const {
  if (frame.positions.rows() != coarse_.vertex_count() || !all_finite(frame.positions)) {
    throw_invalid_argument("frame " + std::to_string(frame.index) +
                           ": coarse positions of another mesh, or not finite");
  }
  const std::vector<TexelTaps>& taps = map_.coarse_taps();
  for (std::size_t i = 0; i < taps.size(); ++i) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (std::size_t k = 0; k < 3; ++k) {
      sum += taps[i].weight[k] * Eigen::Vector3f(frame.positions.row(taps[i].vertex[k]));
    }
    const Eigen::Vector3f aligned = alignment.rotation * sum + alignment.translation;
    for (std::size_t c = 0; c < 3; ++c) planes[c * taps.size() + i] = aligned[static_cast<Eigen::Index>(c)];
  }
}

void PositionImage::target(const Frame&, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const {
  shape_answer(answer);
  const Positions aligned =
      (fine.positions * alignment.rotation.transpose()).rowwise() + alignment.translation.transpose();
  map_.fine_planes(aligned, answer.values.data());
}

void PositionImage::decode(const Tensor& answer, const Positions&, const RigidTransform& alignment,
                           Positions& fine) const {
  check_answer(answer, 3);
  // to_mesh() adds the rest positions.
  map_.to_mesh(answer, alignment, fine);
  fine -= subdivision_.fine.rest_positions * alignment.rotation;
}

void PositionImage::base(const Positions&, const RigidTransform&, Positions& fine) const {
  fine = Positions::Zero(subdivision_.fine.vertex_count(), 3);
}

}  // namespace pleat::conversion
