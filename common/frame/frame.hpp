// What travels from stage to stage, once per frame.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// Seconds between frames where nothing else is said.
inline constexpr double kDefaultFrameTime = 0.04;

/// One frame of one mesh.
struct Frame {
  std::uint64_t index = 0;  ///< frame index, from 0
  double time_s = 0;        ///< time of the scene
  Positions positions;      ///< (V x 3) metres
  Positions velocities;  ///< (V x 3) m/s over one frame: v_k = (x_k - x_{k-1}) / frame time, 0 for the first; or empty
};

/// x -> rotation x + translation.
struct RigidTransform {
  Eigen::Matrix3f rotation = Eigen::Matrix3f::Identity();
  Eigen::Vector3f translation = Eigen::Vector3f::Zero();
};

/// A dense array with named channels, channels first: (C, h, w) for geometry images, (C, V) for vertex features.
struct Tensor {
  std::vector<std::int64_t> shape;
  std::vector<std::string> channels;  ///< one name per entry of the first dimension
  std::vector<float> values;          ///< row-major
};

/// A rigid or animated obstacle in one frame: a sphere (radius > 0), a capsule set (capsule_radii not empty), or a
/// mesh.
struct ObstacleFrame {
  std::string name;
  Eigen::Vector3f center = Eigen::Vector3f::Zero();  ///< sphere
  float radius = 0;                                  ///< sphere; 0 for the others
  Positions positions;                               ///< mesh: (V x 3); its faces are in ObstacleShape
  Positions capsule_ends;                            ///< capsule set: (2C x 3), the two ends of each capsule in turn
  std::vector<float> capsule_radii;                  ///< capsule set: (C) metres, > 0
};

/// What stays constant of an obstacle.
struct ObstacleShape {
  std::string name;
  Faces faces;                 ///< of a mesh; empty for the others
  std::uint32_t capsules = 0;  ///< of a capsule set: everything within a radius of some segments; 0 for the others
};

}  // namespace pleat
