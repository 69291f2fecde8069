#include "services/simulation/obstacles.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>
#include <utility>

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

constexpr std::size_t kMaxCapsules = 10'000;
// Metres from the origin: as far as the cloth may get. Squares of larger floats are not finite.
constexpr double kFarthest = 1e5;

bool is_mesh(const Obstacle& obstacle) { return obstacle.mesh.face_count() > 0; }

// The points before any motion.
std::vector<Vector3d> rest_points(const Obstacle& obstacle) {
  std::vector<Vector3d> points;
  points.reserve(point_count(obstacle));
  if (is_mesh(obstacle)) {
    for (Eigen::Index v = 0; v < obstacle.mesh.vertex_count(); ++v) {
      points.emplace_back(obstacle.mesh.rest_positions.row(v).cast<double>().transpose() + obstacle.center);
    }
  } else if (!obstacle.capsules.empty()) {
    for (const Capsule& capsule : obstacle.capsules) {
      points.emplace_back(capsule.a + obstacle.center);
      points.emplace_back(capsule.b + obstacle.center);
    }
  } else {
    points.push_back(obstacle.center);
  }
  return points;
}

// Closed: with consistent orientation and at most two faces on an edge, it means 2 E = 3 F.
bool is_closed(const Topology& mesh) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) edges.insert(std::minmax(mesh.faces(f, k), mesh.faces(f, (k + 1) % 3)));
  }
  return 2 * edges.size() == 3 * static_cast<std::size_t>(mesh.face_count());
}

std::string capsule_fault(const Obstacle& obstacle) {
  if (obstacle.capsules.size() > kMaxCapsules) {
    return "has " + std::to_string(obstacle.capsules.size()) + " capsules, at most " + std::to_string(kMaxCapsules);
  }
  for (std::size_t i = 0; i < obstacle.capsules.size(); ++i) {
    const Capsule& capsule = obstacle.capsules[i];
    const std::string which = ": capsule " + std::to_string(i);
    if (!capsule.a.allFinite() || !capsule.b.allFinite()) return which + " has an end that is not finite";
    if (!(capsule.radius > 0) || !std::isfinite(capsule.radius)) return which + " needs a positive radius";
  }
  return "";
}

std::string animation_fault(const Obstacle& obstacle) {
  const Animation& animation = obstacle.animation;
  if (!obstacle.motion.keys.empty()) return "has key frames and an animation";
  if (!(animation.sample_time_s > 0) || !std::isfinite(animation.sample_time_s)) {
    return ": the time between two samples of the animation must be positive";
  }
  const auto points = static_cast<Eigen::Index>(point_count(obstacle));
  for (std::size_t k = 0; k < animation.samples.size(); ++k) {
    const Positions& sample = animation.samples[k];
    const std::string which = ": sample " + std::to_string(k) + " of the animation";
    if (sample.rows() != points) {
      return which + " has " + std::to_string(sample.rows()) + " points instead of " + std::to_string(points);
    }
    for (Eigen::Index v = 0; v < points; ++v) {
      if (!sample.row(v).allFinite()) return which + " is not finite at point " + std::to_string(v);
      if (static_cast<double>(sample.row(v).cwiseAbs().maxCoeff()) > kFarthest) {
        return which + " is more than 100 km away at point " + std::to_string(v);
      }
    }
  }
  return "";
}

}  // namespace

std::string obstacle_fault(const Obstacle& obstacle) {
  if (!obstacle.center.allFinite()) return ": centre is not finite";
  if (!(obstacle.radius >= 0) || !std::isfinite(obstacle.radius)) return ": radius must not be negative";
  std::string shapes;
  const auto add_shape = [&](bool there, const char* name) {
    if (there) shapes += (shapes.empty() ? "" : " and ") + std::string(name);
  };
  add_shape(obstacle.radius > 0, "a radius");
  add_shape(!obstacle.capsules.empty(), "capsules");
  add_shape(is_mesh(obstacle), "a mesh");
  if (shapes.empty()) return "has neither a radius nor capsules nor a mesh";
  if (shapes.find(" and ") != std::string::npos) return "has " + shapes;
  if (is_mesh(obstacle)) {
    validate_topology(obstacle.mesh, "obstacle '" + obstacle.name + "'");
    if (!is_closed(obstacle.mesh)) return ": the mesh is not closed";
  }
  std::string fault = capsule_fault(obstacle);
  if (fault.empty() && !obstacle.animation.samples.empty()) fault = animation_fault(obstacle);
  return fault;
}

std::size_t point_count(const Obstacle& obstacle) {
  if (is_mesh(obstacle)) return static_cast<std::size_t>(obstacle.mesh.vertex_count());
  return obstacle.capsules.empty() ? 1 : 2 * obstacle.capsules.size();
}

std::vector<Vector3d> points_at(const Obstacle& obstacle, double time_s) {
  std::vector<Vector3d> points(point_count(obstacle));
  points_at(obstacle, time_s, points);
  return points;
}

void points_at(const Obstacle& obstacle, double time_s, std::span<Vector3d> points) {
  const Animation& animation = obstacle.animation;
  if (!animation.samples.empty()) {
    const auto last = static_cast<double>(animation.samples.size() - 1);
    const double sample = std::clamp(time_s / animation.sample_time_s, 0.0, last);
    const auto before = static_cast<std::size_t>(sample);
    const std::size_t after = std::min(before + 1, animation.samples.size() - 1);
    const double fraction = sample - static_cast<double>(before);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      points[i] = (1 - fraction) * animation.samples[before].row(row).cast<double>().transpose() +
                  fraction * animation.samples[after].row(row).cast<double>().transpose();
    }
    return;
  }
  const std::vector<Vector3d> rest = rest_points(obstacle);
  std::copy(rest.begin(), rest.end(), points.begin());
  if (obstacle.motion.keys.empty()) return;
  Vector3d pivot = Vector3d::Zero();
  for (const Vector3d& p : points) pivot += p / static_cast<double>(points.size());
  const Pose pose = pose_at(obstacle.motion, pivot, time_s);
  for (Vector3d& p : points) p = pose.apply(p);
}

ObstacleShape shape_of(const Obstacle& obstacle) {
  return {obstacle.name, obstacle.mesh.faces, static_cast<std::uint32_t>(obstacle.capsules.size())};
}

ObstacleFrame frame_of(const Obstacle& obstacle, std::span<const Vector3d> points) {
  ObstacleFrame frame;
  frame.name = obstacle.name;
  if (obstacle.radius > 0) {
    frame.center = points[0].cast<float>();
    frame.radius = static_cast<float>(obstacle.radius);
    return frame;
  }
  Positions positions(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i) {
    positions.row(static_cast<Eigen::Index>(i)) = points[i].cast<float>().transpose();
  }
  if (is_mesh(obstacle)) {
    frame.positions = std::move(positions);
  } else {
    frame.capsule_ends = std::move(positions);
    for (const Capsule& capsule : obstacle.capsules) {
      frame.capsule_radii.push_back(static_cast<float>(capsule.radius));
    }
  }
  return frame;
}

}  // namespace pleat::simulation
