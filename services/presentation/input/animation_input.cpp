#include "services/presentation/input/animation_input.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "common/scene/animation_parts.hpp"
#include "services/presentation/input/point_sequence.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

void check_points(const std::string& source, Eigen::Index points, std::uint64_t found) {
  if (found == static_cast<std::uint64_t>(points)) return;
  throw_invalid_argument(source + " has " + std::to_string(found) + " points, the obstacle " + std::to_string(points));
}

void check_size(const std::string& source, std::uint64_t samples, Eigen::Index points) {
  if (samples == 0) throw_invalid_argument(source + " has no samples");
  const std::uint64_t row = 12 * static_cast<std::uint64_t>(points);
  if (samples <= kMaxAnimationBytes / row) return;
  throw Error(ErrorCode::kResourceExhausted, source + ": " + std::to_string(samples) + " samples of " +
                                                 std::to_string(points) + " points are more than the " +
                                                 std::to_string(kMaxAnimationBytes >> 20) +
                                                 " MiB that a scene can hold");
}

}  // namespace

std::vector<Positions> read_animation(const fs::path& source, Eigen::Index points, std::size_t most) {
  const std::string text = source.string();
  const auto sequence = open_points(text);
  check_points(text, points, static_cast<std::uint64_t>(sequence->point_count()));
  const std::size_t count = std::min(sequence->frame_count(), most);
  check_size(text, count, points);
  std::vector<Positions> samples;
  for (std::size_t k = 0; k < count; ++k) samples.push_back(sequence->positions(k));
  return samples;
}

}  // namespace pleat::presentation
