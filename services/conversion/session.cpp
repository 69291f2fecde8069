#include "services/conversion/session.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::conversion {
namespace {

constexpr std::uint32_t kDefaultRounds = 2, kMaxRounds = 5;

void check_size(double vertices, std::int64_t limit, const char* what) {
  if (vertices <= static_cast<double>(limit)) return;
  throw Error(ErrorCode::kResourceExhausted, std::string(what) + ": about " +
                                                 std::to_string(static_cast<std::int64_t>(vertices)) +
                                                 ", more than this service's limit of " + std::to_string(limit));
}

Normalization normalization_from(const v1::Normalization& message) {
  Normalization n;
  n.minimum.assign(message.minimum().begin(), message.minimum().end());
  n.maximum.assign(message.maximum().begin(), message.maximum().end());
  if (n.minimum.empty() && n.maximum.empty()) return n;
  if (n.minimum.size() != kImageChannels || n.maximum.size() != kImageChannels) {
    throw_invalid_argument("open.setup.normalization: " + std::to_string(n.minimum.size()) + " minima and " +
                           std::to_string(n.maximum.size()) + " maxima, expected 9 of each");
  }
  for (std::size_t c = 0; c < kImageChannels; ++c) {
    if (std::isfinite(n.minimum[c]) && std::isfinite(n.maximum[c]) && n.minimum[c] <= n.maximum[c]) continue;
    throw_invalid_argument("open.setup.normalization: the range of " + image_channel_names()[c] +
                           " is not finite or inverted");
  }
  return n;
}

ImageSpec spec_from(const v1::ConversionSetup& setup, std::int64_t max_texels) {
  ImageSpec spec;
  const auto extent = [](std::uint32_t value) { return static_cast<int>(std::min(value, 1u << 20)); };
  spec.coarse_width = extent(setup.coarse_width());
  spec.coarse_height = extent(setup.coarse_height());
  if (setup.texels_per_fine_vertex() != 0)
    spec.texels_per_fine_vertex = static_cast<double>(setup.texels_per_fine_vertex());
  if (setup.scale() != 0) spec.scale = extent(setup.scale());
  spec.max_fine_texels = max_texels;
  return spec;
}

// Everything that decides the maps.
std::string key_of(const Topology& coarse, const Topology* fine, std::uint32_t rounds, const ImageSpec& spec) {
  std::string key = topology_hash(coarse) + (fine != nullptr ? topology_hash(*fine) : " r" + std::to_string(rounds));
  for (const int value : {spec.coarse_width, spec.coarse_height, spec.scale}) key += " " + std::to_string(value);
  return spec.coarse_width == 0 ? key + " " + std::to_string(spec.texels_per_fine_vertex) : key;
}

}  // namespace

Session::Session(const v1::ConversionSetup& setup, const SessionLimits& limits, MapCache& cache)
    : normalization_(normalization_from(setup.normalization())) {
  if (!normalization_.minimum.empty()) {
    displacement_ = {{normalization_.minimum.begin(), normalization_.minimum.begin() + 3},
                     {normalization_.maximum.begin(), normalization_.maximum.begin() + 3}};
  }
  const Topology coarse = from_message(setup.coarse(), "open.setup.coarse");
  coarse_vertices_ = coarse.vertex_count();
  const ImageSpec spec = spec_from(setup, limits.max_texels);
  const std::uint32_t rounds = setup.has_subdivision_rounds() ? setup.subdivision_rounds() : kDefaultRounds;
  Topology fine;
  const bool has_fine = setup.has_fine() && setup.fine().faces_size() > 0;
  if (has_fine) {
    fine = from_message(setup.fine(), "open.setup.fine");
    check_size(static_cast<double>(fine.vertex_count()), limits.max_vertices,
               "open.setup.fine: vertices of the fine mesh");
  } else {
    if (rounds > kMaxRounds) {
      throw_invalid_argument("open.setup.subdivision_rounds: at most 5, not " + std::to_string(rounds));
    }
    check_size(static_cast<double>(coarse.vertex_count()) * std::pow(4.0, rounds), limits.max_vertices,
               "open.setup: vertices of the fine mesh");
  }
  const auto build = [&] {
    auto maps = std::make_shared<SessionMaps>();
    if (has_fine) {
      maps->fine = std::move(fine);
    } else {
      Subdivision subdivision = subdivide(coarse, static_cast<int>(rounds));
      maps->fine = std::move(subdivision.fine);
      maps->feature_vertices = std::move(subdivision.feature_vertices);
    }
    maps->map = std::make_unique<ImageMap>(coarse, maps->fine, spec);
    return maps;
  };
  maps_ = cache.get(key_of(coarse, has_fine ? &fine : nullptr, rounds, spec), build, &maps_were_cached_);
  const ImageMap& map = *maps_->map;
  spdlog::info("session: {} coarse and {} fine vertices, images of {} x {} and {} x {} texels{}", coarse_vertices_,
               maps_->fine.vertex_count(), map.coarse_width(), map.coarse_height(), map.fine_width(), map.fine_height(),
               maps_were_cached_ ? ", maps from the cache" : "");
  const Eigen::Vector2d scale = map.material_scale();
  if (scale != Eigen::Vector2d::Ones()) {
    spdlog::info("session: material coordinates are not in metres; by the rest mesh a unit is {:.4g} x {:.4g} m",
                 scale.x(), scale.y());
  }
}

void Session::describe(bool with_fine, v1::ConversionOpened* opened) const {
  opened->set_coarse_width(static_cast<std::uint32_t>(maps_->map->coarse_width()));
  opened->set_coarse_height(static_cast<std::uint32_t>(maps_->map->coarse_height()));
  opened->set_fine_width(static_cast<std::uint32_t>(maps_->map->fine_width()));
  opened->set_fine_height(static_cast<std::uint32_t>(maps_->map->fine_height()));
  if (!with_fine) return;
  *opened->mutable_fine() = to_message(maps_->fine);
  opened->mutable_feature_vertices()->Add(maps_->feature_vertices.begin(), maps_->feature_vertices.end());
}

void Session::to_image(const v1::Frame& request, v1::ImageFrame* response) {
  const Frame frame = from_message(request, coarse_vertices_, "frame");
  const RigidTransform transform = maps_->map->align(frame.positions);
  maps_->map->coarse_image(frame, transform, image_);
  response->set_out_of_range(
      normalization_.minimum.empty() ? 0 : static_cast<std::uint32_t>(normalize(image_, normalization_)));
  response->set_index(frame.index);
  response->set_time_s(frame.time_s);
  to_message(image_, response->mutable_image());
  *response->mutable_alignment() = to_message(transform);
}

void Session::to_mesh(const v1::ImageFrame& request, v1::MeshFrame* response) {
  Tensor image = from_message(request.image(), "frame.image");
  const RigidTransform transform = from_message(request.alignment(), "frame.alignment");
  if (image.shape.size() != 3 || image.shape[0] < 3 || image.shape[0] > kImageChannels) {
    throw_invalid_argument("frame.image: expected 3 to 9 channels, height and width");
  }
  if (!displacement_.minimum.empty()) {
    // Positions need the three displacement channels only.
    image.values.resize(image.values.size() / static_cast<std::size_t>(image.shape[0]) * 3);
    image.shape[0] = 3;
    denormalize(image, displacement_);
  }
  maps_->map->to_mesh(image, transform, positions_);
  v1::Frame* fine = response->mutable_fine();
  fine->set_index(request.index());
  fine->set_time_s(request.time_s());
  to_message(positions_, fine->mutable_positions());
  *response->mutable_stage_times() = request.stage_times();
}

}  // namespace pleat::conversion
