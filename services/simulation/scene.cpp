#include "services/simulation/scene.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "services/simulation/obstacles.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

constexpr int kMaxSteps = 10'000;
// Fine vertices beyond this do not fit the wire's limits.
constexpr double kMaxFineFaces = 8e6;

[[noreturn]] void fail(const Scene& scene, const std::string& message) {
  throw_invalid_argument("scene '" + scene.name + "': " + message);
}

void check_finite(const Scene& scene, double value, const std::string& what) {
  if (!std::isfinite(value)) fail(scene, what + " is not finite");
}

void check_finite(const Scene& scene, const Vector3d& value, const std::string& what) {
  if (!value.allFinite()) fail(scene, what + " is not finite");
}

void check_positive(const Scene& scene, double value, const std::string& what) {
  check_finite(scene, value, what);
  if (value <= 0) fail(scene, what + " must be positive");
}

void check_not_negative(const Scene& scene, double value, const std::string& what) {
  check_finite(scene, value, what);
  if (value < 0) fail(scene, what + " must not be negative");
}

// Beyond what cloth meets anywhere, far enough from where a step's arithmetic gets lost.
constexpr double kFarthest = 1e5;                    // m
constexpr double kFastest = 1e4;                     // m/s
constexpr double kStrongestPull = 1e4;               // m/s^2
constexpr double kLightest = 1e-4, kHeaviest = 1e3;  // kg/m^2

void check_at_most(const Scene& scene, const Vector3d& value, double limit, const char* unit, const std::string& what) {
  check_finite(scene, value, what);
  if (value.norm() <= limit) return;
  char text[64];
  std::snprintf(text, sizeof text, " is %.3g %s, at most %g are possible", value.norm(), unit, limit);
  fail(scene, what + text);
}

void check_motion(const Scene& scene, const Motion& motion, const std::string& what) {
  for (std::size_t i = 0; i < motion.keys.size(); ++i) {
    const std::string key = what + ", key frame " + std::to_string(i);
    check_finite(scene, motion.keys[i].time_s, key + ": time");
    check_at_most(scene, motion.keys[i].translation, kFarthest, "m", key + ": translation");
    check_finite(scene, motion.keys[i].rotation, key + ": rotation");
    if (i > 0 && motion.keys[i].time_s <= motion.keys[i - 1].time_s) fail(scene, key + ": times must ascend");
  }
}

void check_layers(const Scene& scene) {
  if (scene.layers.empty()) return;
  Eigen::Index first = 0;
  std::vector<std::size_t> layer_of(static_cast<std::size_t>(scene.garment.vertex_count()), scene.layers.size());
  for (std::size_t l = 0; l < scene.layers.size(); ++l) {
    const GarmentLayer& layer = scene.layers[l];
    if (layer.faces < 1 || layer.faces > scene.garment.face_count() - first) {
      fail(scene, "layer '" + layer.name + "' has " + std::to_string(layer.faces) + " of the " +
                      std::to_string(scene.garment.face_count() - first) + " faces that are left");
    }
    for (Eigen::Index f = first; f < first + layer.faces; ++f) {
      for (int k = 0; k < 3; ++k) {
        std::size_t& of = layer_of[scene.garment.faces(f, k)];
        if (of < l) {
          fail(scene, "layers '" + scene.layers[of].name + "' and '" + layer.name + "' share vertex " +
                          std::to_string(scene.garment.faces(f, k)));
        }
        of = l;
      }
    }
    first += layer.faces;
  }
  if (first < scene.garment.face_count()) {
    fail(scene, "the layers have " + std::to_string(first) + " of the garment's " +
                    std::to_string(scene.garment.face_count()) + " faces");
  }
}

void check_handles(const Scene& scene) {
  for (std::size_t h = 0; h < scene.handles.size(); ++h) {
    const Handle& handle = scene.handles[h];
    const std::string what = "handle " + (handle.name.empty() ? std::to_string(h) : "'" + handle.name + "'");
    if (handle.vertices.empty()) fail(scene, what + " has no vertices");
    for (const std::uint32_t v : handle.vertices) {
      if (v >= static_cast<std::uint64_t>(scene.garment.vertex_count())) {
        fail(scene, what + " is on vertex " + std::to_string(v) + ", but the garment has " +
                        std::to_string(scene.garment.vertex_count()));
      }
    }
    check_finite(scene, handle.start_s, what + ": start");
    if (std::isnan(handle.end_s) || handle.end_s <= handle.start_s) fail(scene, what + ": ends before it starts");
    if (!handle.hard) check_positive(scene, handle.stiffness, what + ": stiffness");
    check_motion(scene, handle.motion, what);
    for (std::size_t other = 0; other < h; ++other) {
      const Handle& o = scene.handles[other];
      if (o.start_s >= handle.end_s || handle.start_s >= o.end_s) continue;
      const std::set<std::uint32_t> taken(o.vertices.begin(), o.vertices.end());
      for (const std::uint32_t v : handle.vertices) {
        if (taken.contains(v)) fail(scene, what + ": vertex " + std::to_string(v) + " is in another handle as well");
      }
    }
  }
}

void check_obstacles(const Scene& scene) {
  std::set<std::string> names;
  for (const Obstacle& obstacle : scene.obstacles) {
    const std::string what = "obstacle '" + obstacle.name + "'";
    if (obstacle.name.empty()) fail(scene, "an obstacle has no name");
    if (!names.insert(obstacle.name).second) fail(scene, what + " appears twice");
    const std::string fault = obstacle_fault(obstacle);
    if (!fault.empty()) fail(scene, what + (fault[0] == ':' ? "" : " ") + fault);
    check_at_most(scene, obstacle.center, kFarthest, "m", what + ": centre");
    check_motion(scene, obstacle.motion, what);
  }
}

// Catmull-Rom tangent at key i of the component that `get` reads.
template <typename Get>
Vector3d tangent(const std::vector<KeyFrame>& keys, std::size_t i, const Get& get) {
  const std::size_t before = i == 0 ? 0 : i - 1, after = std::min(i + 1, keys.size() - 1);
  // At the ends the motion starts and stops smoothly.
  if (before == i || after == i) return Vector3d::Zero();
  return (get(keys[after]) - get(keys[before])) / (keys[after].time_s - keys[before].time_s);
}

template <typename Get>
Vector3d interpolate(const std::vector<KeyFrame>& keys, double time_s, const Get& get) {
  if (time_s <= keys.front().time_s) return get(keys.front());
  if (time_s >= keys.back().time_s) return get(keys.back());
  std::size_t i = 0;
  while (keys[i + 1].time_s <= time_s) ++i;
  const double length = keys[i + 1].time_s - keys[i].time_s;
  const double t = (time_s - keys[i].time_s) / length, t2 = t * t, t3 = t2 * t;
  return (2 * t3 - 3 * t2 + 1) * get(keys[i]) + (t3 - 2 * t2 + t) * length * tangent(keys, i, get) +
         (3 * t2 - 2 * t3) * get(keys[i + 1]) + (t3 - t2) * length * tangent(keys, i + 1, get);
}

// Beyond this many radians a step the averages are where they should be after every step, and what is stiffer only
// makes the linear system worse.
constexpr double kMostRadians = 10;

double fastest_tracking(const Scene& scene) {
  const int coarse_steps = std::min(scene.tracking.coarse_steps, scene.steps_per_frame);
  return kMostRadians * scene.steps_per_frame / (scene.frame_time_s * coarse_steps);
}

void check_tracking(const Scene& scene) {
  const Tracking& tracking = scene.tracking;
  check_not_negative(scene, tracking.spring, "tracking: spring");
  check_not_negative(scene, tracking.frequency, "tracking: frequency");
  if (tracking.coarse_steps < 1) fail(scene, "tracking: a fine step is at least one coarse step");
  if (tracking.frequency > fastest_tracking(scene) && tracking.frequency != Tracking::kDefaultFrequency) {
    char text[120];
    std::snprintf(text, sizeof text, "tracking: frequency is %.6g rad/s; steps of %.3g ms follow at most %.6g",
                  tracking.frequency, 1e3 * kMostRadians / fastest_tracking(scene), fastest_tracking(scene));
    fail(scene, text);
  }
}

}  // namespace

void validate_scene(const Scene& scene) {
  validate_topology(scene.garment, "scene '" + scene.name + "', garment");
  validate_material_coordinates(scene.garment, "scene '" + scene.name + "', garment");
  check_layers(scene);
  check_at_most(scene, scene.transform.translation, kFarthest, "m", "initial translation");
  check_finite(scene, scene.transform.rotation, "initial rotation");
  check_positive(scene, scene.transform.scale, "initial scale");
  check_at_most(scene, scene.velocity, kFastest, "m/s", "initial velocity");
  check_not_negative(scene, scene.perturbation_m, "perturbation");
  check_positive(scene, scene.material.density, "material: density");
  check_positive(scene, scene.density_multiplier, "density multiplier");
  const double density = scene.material.density * scene.density_multiplier;
  if (density < kLightest || density > kHeaviest) {
    char text[96];
    std::snprintf(text, sizeof text, "material: density is %.3g kg/m2; cloth has %g to %g", density, kLightest,
                  kHeaviest);
    fail(scene, text);
  }
  check_positive(scene, scene.stretching_multiplier, "stretching multiplier");
  check_not_negative(scene, scene.bending_multiplier, "bending multiplier");
  check_not_negative(scene, scene.damping_s, "damping");
  if (!(scene.strain_limits.minimum >= 0 && scene.strain_limits.minimum <= 1)) {
    fail(scene, "strain limits: the smallest stretch must be 0 (no limit) to 1");
  }
  if (!(scene.strain_limits.maximum >= 1)) fail(scene, "strain limits: the largest stretch must be at least 1");
  check_positive(scene, scene.frame_time_s, "frame time");
  if (scene.frame_time_s > 10) fail(scene, "frame time must be at most 10 s");
  if (scene.steps_per_frame < 1 || scene.steps_per_frame > kMaxSteps) {
    fail(scene, "steps per frame must be 1 to " + std::to_string(kMaxSteps) + ", not " +
                    std::to_string(scene.steps_per_frame));
  }
  if (scene.frames < 1 || static_cast<std::uint64_t>(scene.frames) > kMaxFrames) {
    fail(scene, "frames must be 1 to " + std::to_string(kMaxFrames) + ", not " + std::to_string(scene.frames));
  }
  check_at_most(scene, scene.gravity, kStrongestPull, "m/s2", "gravity");
  check_not_negative(scene, scene.wind.density, "wind: density");
  check_at_most(scene, scene.wind.velocity, kFastest, "m/s", "wind: velocity");
  check_not_negative(scene, scene.wind.drag, "wind: drag");
  check_handles(scene);
  if (!(scene.handle_stretch_warning >= 1)) fail(scene, "handle stretch warning must be at least 1");
  check_obstacles(scene);
  check_positive(scene, scene.contact.thickness, "contact: thickness");
  check_not_negative(scene, scene.contact.stiffness, "contact: stiffness");
  check_not_negative(scene, scene.contact.friction, "contact: friction");
  check_not_negative(scene, scene.contact.obstacle_friction, "contact: obstacle friction");
  if (scene.subdivision_rounds < 0 || scene.subdivision_rounds > 5) {
    fail(scene, "subdivision rounds must be 0 to 5, not " + std::to_string(scene.subdivision_rounds));
  }
  if (static_cast<double>(scene.garment.face_count()) * std::pow(4.0, scene.subdivision_rounds) > kMaxFineFaces) {
    fail(scene, "the subdivided garment would have more than 8,000,000 faces");
  }
  check_tracking(scene);
  if (scene.threads < 0 || scene.threads > 1024) fail(scene, "threads must be 0 to 1024");
}

double tracking_frequency(const Scene& scene) { return std::min(scene.tracking.frequency, fastest_tracking(scene)); }

Eigen::Matrix3d rotation_matrix(const Vector3d& axis_angle) {
  const double angle = axis_angle.norm();
  if (angle == 0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, axis_angle / angle).toRotationMatrix();
}

Pose pose_at(const Motion& motion, const Vector3d& pivot, double time_s) {
  Pose pose;
  if (motion.keys.empty()) return pose;
  pose.rotation =
      rotation_matrix(interpolate(motion.keys, time_s, [](const KeyFrame& k) -> Vector3d { return k.rotation; }));
  const Vector3d translation =
      interpolate(motion.keys, time_s, [](const KeyFrame& k) -> Vector3d { return k.translation; });
  pose.translation = pivot + translation - pose.rotation * pivot;
  return pose;
}

}  // namespace pleat::simulation
