// What to simulate: a plain value with visible defaults. The wire form is pleat.v1.Scene.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/material.hpp"

namespace pleat::simulation {

/// A pose at a time: x -> R (x - pivot) + pivot + translation. The pivot of a handle is the centroid of its vertices at
/// its start, that of an obstacle the mean of its points (Animation).
struct KeyFrame {
  double time_s = 0;
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< metres
  Eigen::Vector3d rotation = Eigen::Vector3d::Zero();     ///< axis times angle, radians
};

/// A scripted motion: cubic Hermite through the key frames with Catmull-Rom tangents (per component), constant before
/// the first and after the last. No key frames: at rest.
struct Motion {
  std::vector<KeyFrame> keys;  ///< times strictly ascending
};

/// Holds coarse vertices (in a fine simulation: the fine vertices inside what they span as well).
struct Handle {
  std::string name;
  std::vector<std::uint32_t> vertices;  ///< coarse vertex indices
  double start_s = 0;
  double end_s = 1e30;     ///< released then
  bool hard = false;       ///< positions are prescribed instead of pulled
  double stiffness = 1e3;  ///< N/m per vertex, soft handles
  Motion motion;           ///< applied to the positions the vertices have at the start of the handle
};

/// Everything within `radius` of the segment a-b; a sphere if that has no length.
struct Capsule {
  Eigen::Vector3d a = Eigen::Vector3d::Zero(), b = Eigen::Vector3d::Zero();  ///< metres, before motion
  double radius = 0;
};

/// Where the points of an obstacle are over time: sample k at k sample_time_s, linear in between, constant after the
/// last. The points are a mesh's vertices, the two ends of every capsule in turn, a sphere's centre.
struct Animation {
  std::vector<Positions> samples;  ///< each (points x 3), metres, in world coordinates
  double sample_time_s = 0.04;
};

/// A sphere (radius > 0), a capsule set or a closed triangle mesh: at rest, moved rigidly by its key frames, or
/// animated. It pushes the cloth and never yields.
struct Obstacle {
  std::string name;
  Eigen::Vector3d center =
      Eigen::Vector3d::Zero();    ///< sphere: its centre before motion; the others: a translation before motion
  double radius = 0;              ///< sphere
  std::vector<Capsule> capsules;  ///< capsule set
  Topology mesh;                  ///< mesh: rest_positions and faces (outward orientation)
  Motion motion;                  ///< about its pivot, in world coordinates
  Animation animation;            ///< instead of center and motion
};

/// Where the garment is at the beginning: x -> R (scale x) + translation.
struct InitialTransform {
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotation = Eigen::Vector3d::Zero();  ///< axis times angle, radians
  double scale = 1;                                    ///< scales the rest shape and its material coordinates too
};

/// One of several garments that are worn over each other: it has the `faces` faces of the scene's garment after those
/// of the layers before. No vertex belongs to two.
struct GarmentLayer {
  std::string name;
  Eigen::Index faces = 0;
};

/// The range of the principal stretches of the faces, 1 at rest.
struct StretchRange {
  double minimum = 0;    ///< 0 to 1; 0: no limit
  double maximum = 1e9;  ///< at least 1; 1e9: no limit

  bool limits() const { return minimum > 0 || maximum < 1e9; }
};

struct Wind {
  double density = 1;                                  ///< of the air, kg/m^3; 0 turns the pressure off
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< m/s
  double drag = 0;                                     ///< tangential, N s/m^3
};

struct Contact {
  double thickness = 5e-3;  ///< metres: repulsion starts there; at most a quarter of the mean edge length is used
  double stiffness = 1e6;   ///< N/m^3: pressure per penetration of the repulsion layer
  double friction = 0.6;    ///< cloth on cloth
  double obstacle_friction = 0.3;
  bool self_collision = true;
};

/// How the fine simulation follows the coarse one: by averages (averages.hpp), or as [MFSR] section 4.2 has it
/// (published_tracking()), or both.
struct Tracking {
  static constexpr double kDefaultFrequency = 7;
  /// rad/s, with which averages swing about those of the coarse cloth; 0: they don't follow. At most 10 radians a fine
  /// step, to which the default is lowered in scenes with steps so long.
  double frequency = kDefaultFrequency;
  double spring = 0;       ///< c, N/m per feature vertex; 0: none
  int coarse_steps = 2;    ///< per fine step; 2 instead of 1 changes the fine tablecloth by 0.3 mm RMS
  bool two_level = false;  ///< the coarse topology's forces on the feature vertices, on top of the fine ones
};

/// Springs of 10 N/m and two levels: what a scene means that sets either of them and no frequency.
inline Tracking published_tracking() { return {.frequency = 0, .spring = 10, .two_level = true}; }

struct Scene {
  std::string name;

  Topology garment;                  ///< coarse, with material coordinates
  std::vector<GarmentLayer> layers;  ///< the innermost first, normals outwards; empty: one garment
  InitialTransform transform;
  double perturbation_m = 0;  ///< amplitude of smooth seeded noise along the normals of the initial shape
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< initial, m/s
  bool untangle = false;                               ///< a start that is not clean is relaxed instead of refused

  Material material;
  double density_multiplier = 1;
  double stretching_multiplier = 1;
  double bending_multiplier = 1;
  double damping_s = 0;        ///< stiffness-proportional damping, seconds
  StretchRange strain_limits;  ///< kept by a projection after each step, before collisions are resolved

  double frame_time_s = kDefaultFrameTime;
  int steps_per_frame = 8;
  int frames = 100;  ///< including frame 0, the initial state

  Eigen::Vector3d gravity{0, -9.81, 0};
  Wind wind;
  std::vector<Handle> handles;
  double handle_stretch_warning = 2;  ///< a stretch of the cloth at a handle beyond this is worth a warning; at least 1
  std::vector<Obstacle> obstacles;
  Contact contact;
  int subdivision_rounds = kDefaultSubdivisionRounds;
  SubdivisionRule subdivision_rule = SubdivisionRule::kMidpoint;  ///< kSmooth: a free fine simulation's only
  Tracking tracking;
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: the processors this process may use
};

/// Throws kInvalidArgument with the culprit: garment not usable (validate_topology, validate_material_coordinates),
/// layers that aren't the garment's faces or share vertices, handle on a vertex that does not exist or the same vertex
/// in two handles at once, strain limits without 1, steps, frames or frame time not positive, values not finite,
/// negative density, stiffness, friction or thickness, key frames out of order, an obstacle without shape or with two,
/// an animation that does not fit it or has values that are not finite, or duplicate obstacle names. Whether the start
/// is free of penetrations and self-intersections is checked by Simulation, which has the hierarchies. O(F log F).
void validate_scene(const Scene& scene);

/// rad/s: the scene's, or less with steps so long that they could not follow it.
double tracking_frequency(const Scene& scene);

/// The pose of a motion at a time: rotation matrix and offset of x -> R x + t.
struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d apply(const Eigen::Vector3d& x) const { return rotation * x + translation; }
};
Pose pose_at(const Motion& motion, const Eigen::Vector3d& pivot, double time_s);

/// exp of an axis-angle vector.
Eigen::Matrix3d rotation_matrix(const Eigen::Vector3d& axis_angle);

}  // namespace pleat::simulation
