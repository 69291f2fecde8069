#include "common/scene/animation_parts.hpp"

#include <algorithm>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr std::size_t kPartValues = 1u << 20;

}  // namespace

std::size_t animated_points(const v1::Obstacle& obstacle) {
  if (obstacle.has_mesh()) return static_cast<std::size_t>(obstacle.mesh().rest_positions_size()) / 3;
  return obstacle.has_capsules() ? 2 * static_cast<std::size_t>(obstacle.capsules().capsules_size()) : 1;
}

std::vector<v1::AnimationPart> take_animations(v1::Scene& scene, std::uint64_t inline_bytes) {
  std::uint64_t bytes = 0;
  for (const v1::Obstacle& obstacle : scene.obstacles()) {
    bytes += sizeof(float) * static_cast<std::uint64_t>(obstacle.animation().positions_size());
  }
  std::vector<v1::AnimationPart> parts;
  if (bytes <= inline_bytes) return parts;
  for (v1::Obstacle& obstacle : *scene.mutable_obstacles()) {
    const auto values = static_cast<std::size_t>(obstacle.animation().positions_size());
    const std::size_t row = 3 * animated_points(obstacle);
    if (values == 0 || row == 0 || values % row != 0) continue;
    v1::Animation& animation = *obstacle.mutable_animation();
    const float* positions = animation.positions().data();
    const std::size_t length = row * std::max<std::size_t>(1, kPartValues / row);
    for (std::size_t first = 0; first < values; first += length) {
      v1::AnimationPart& part = parts.emplace_back();
      part.set_obstacle(obstacle.name());
      part.mutable_positions()->Add(positions + first, positions + std::min(values, first + length));
    }
    animation.set_samples(static_cast<std::uint32_t>(values / row));
    google::protobuf::RepeatedField<float>().Swap(animation.mutable_positions());
  }
  return parts;
}

AnimationAssembly::AnimationAssembly(v1::Scene& scene, const std::string& field) {
  std::uint64_t bytes = 0;
  for (int o = 0; o < scene.obstacles_size(); ++o) {
    v1::Obstacle& obstacle = *scene.mutable_obstacles(o);
    const std::string where = field + ".obstacles[" + std::to_string(o) + "].animation.samples";
    const std::uint64_t samples = obstacle.animation().samples();
    const std::size_t row = 3 * animated_points(obstacle);
    bytes += sizeof(float) * static_cast<std::uint64_t>(obstacle.animation().positions_size());
    if (samples == 0) continue;
    if (!obstacle.animation().positions().empty()) throw_invalid_argument(where + ": there are positions already");
    if (row == 0) throw_invalid_argument(where + ": the obstacle has no points");
    v1::Animation& animation = *obstacle.mutable_animation();
    if (!missing_.try_emplace(obstacle.name(), Missing{&animation, row, samples * row}).second) {
      throw_invalid_argument(where + ": another obstacle is named '" + obstacle.name() + "' too");
    }
    bytes += sizeof(float) * samples * row;
  }
  if (bytes > kMaxAnimationBytes) {
    throw Error(ErrorCode::kResourceExhausted, field + ": the animations of its obstacles are " +
                                                   std::to_string(bytes >> 20) + " MiB, at most " +
                                                   std::to_string(kMaxAnimationBytes >> 20));
  }
}

void AnimationAssembly::add(const v1::AnimationPart& part) {
  const std::string where = "animation of obstacle '" + part.obstacle() + "'";
  const auto found = missing_.find(part.obstacle());
  if (found == missing_.end()) throw_invalid_argument(where + ": no part of it is missing");
  Missing& missing = found->second;
  auto& positions = *missing.animation->mutable_positions();
  const auto size = static_cast<std::size_t>(part.positions_size());
  if (size == 0 || size % missing.row != 0) {
    throw_invalid_argument(where + ": a part of " + std::to_string(size) + " values, not a multiple of " +
                           std::to_string(missing.row));
  }
  if (static_cast<std::uint64_t>(positions.size()) + size > missing.values) {
    throw_invalid_argument(where + ": more than the " + std::to_string(missing.values / missing.row) +
                           " samples that the scene announces");
  }
  positions.MergeFrom(part.positions());
  if (static_cast<std::uint64_t>(positions.size()) < missing.values) return;
  missing.animation->clear_samples();
  missing_.erase(found);
}

std::string AnimationAssembly::describe_missing() const {
  if (missing_.empty()) return "";
  const auto& [name, missing] = *missing_.begin();
  const auto there = static_cast<std::uint64_t>(missing.animation->positions_size());
  return "obstacle '" + name + "' misses " + std::to_string((missing.values - there) / missing.row) +
         " samples of its animation";
}

}  // namespace pleat
