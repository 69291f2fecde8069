#include "services/presentation/input/obstacle_input.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>

#include "common/base/error.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/holes.hpp"
#include "common/mesh/mesh_file.hpp"

namespace pleat::presentation {
namespace {

/// The numbers after the colon; the last is a radius.
template <std::size_t kCount>
std::array<float, kCount> parse_numbers(const std::string& text, const char* form) {
  std::array<float, kCount> values{};
  const char* at = text.data() + text.find(':') + 1;
  const char* end = text.data() + text.size();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto [next, error] = std::from_chars(at, end, values[i]);
    const bool last = i + 1 == values.size();
    if (error != std::errc{} || !std::isfinite(values[i]) || (last ? next != end : next == end || *next != ','))
      throw_invalid_argument("--obstacle " + text + ": expected " + form + " in metres");
    at = next + 1;
  }
  if (!(values.back() > 0)) throw_invalid_argument("--obstacle " + text + ": the radius must be positive");
  return values;
}

}  // namespace

ObstacleInput::ObstacleInput(const std::vector<std::string>& texts, const AxesAndUnit& files) : files_(files) {
  for (const std::string& text : texts) {
    Obstacle obstacle;
    std::string name = "sphere";
    if (text.starts_with("sphere:")) {
      const auto [x, y, z, radius] = parse_numbers<4>(text, "sphere:X,Y,Z,RADIUS");
      obstacle.rest.center = {x, y, z};
      obstacle.rest.radius = radius;
    } else if (text.starts_with("capsule:")) {
      const auto values = parse_numbers<7>(text, "capsule:X,Y,Z,X,Y,Z,RADIUS");
      name = "capsule";
      obstacle.shape.capsules = 1;
      obstacle.rest.capsule_ends = Eigen::Map<const Positions>(values.data(), 2, 3);
      obstacle.rest.capsule_radii = {values.back()};
    } else {
      const auto at = text.find('@');
      const std::filesystem::path file = text.substr(0, at);
      const bool moved =
          at != std::string::npos || (is_animated_mesh_file(file) && open_animated_mesh(file)->frame_count() > 1);
      Topology open = read_mesh(file, MeshUse::kObstacle);
      open.rest_positions = files(std::move(open.rest_positions));
      const Topology mesh = close_holes(open, moved, file.string(), notes_);
      obstacle.shape.faces = mesh.faces;
      obstacle.rest.positions = mesh.rest_positions;
      if (moved)
        obstacle.motion = open_frame_sequence(at == std::string::npos ? file.string() : text.substr(at + 1), open);
      name = file.stem().string();
    }
    std::string unique = name;
    const auto taken = [this](const std::string& candidate) {
      return std::any_of(obstacles_.begin(), obstacles_.end(),
                         [&](const Obstacle& other) { return other.shape.name == candidate; });
    };
    for (int n = 2; taken(unique); ++n) unique = name + std::to_string(n);
    obstacle.shape.name = obstacle.rest.name = unique;
    obstacles_.push_back(std::move(obstacle));
  }
}

std::vector<ObstacleShape> ObstacleInput::shapes() const {
  std::vector<ObstacleShape> shapes;
  for (const Obstacle& obstacle : obstacles_) shapes.push_back(obstacle.shape);
  return shapes;
}

std::vector<ObstacleFrame> ObstacleInput::at(std::size_t frame) const {
  std::vector<ObstacleFrame> frames;
  for (const Obstacle& obstacle : obstacles_) {
    frames.push_back(obstacle.rest);
    if (obstacle.motion)
      frames.back().positions = files_(obstacle.motion->positions(std::min(frame, obstacle.motion->frame_count() - 1)));
  }
  return frames;
}

}  // namespace pleat::presentation
