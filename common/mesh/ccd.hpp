// Continuous collision detection of vertex-face and edge-edge pairs on linear trajectories.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "common/mesh/closest_points.hpp"

namespace pleat {

struct CcdOptions {
  /// The distance that must be kept (metres): 0 for surfaces, the radius for a sphere's centre.
  double minimum_distance = 0;
  /// A pair counts as colliding once its distance falls to minimum_distance + gap (or to a tenth of its first
  /// clearance, if that is less).
  double gap = 1e-5;
  int max_iterations = 256;  ///< then the pair counts as colliding: conservative
};

/// The first time in [0,1] by which a pair comes too close, and its closest points then. Up to `time` the distance has
/// stayed above the minimum.
struct Collision {
  double time;
  ClosestPoints closest;
};

/// Additive CCD (Li, Kaufman, Jiang 2021): steps that the relative motion can't have used up. Never misses a collision,
/// has no special cases for degenerate or coplanar motion, and may report near misses within the gap.
/// start, end: vertex then face corners, or the ends of one edge then of the other.
std::optional<Collision> vertex_face_ccd(const std::array<Eigen::Vector3d, 4>& start,
                                         const std::array<Eigen::Vector3d, 4>& end, const CcdOptions& options = {});
std::optional<Collision> edge_edge_ccd(const std::array<Eigen::Vector3d, 4>& start,
                                       const std::array<Eigen::Vector3d, 4>& end, const CcdOptions& options = {});

/// The most by which the distance of a pair can change over the motion: the farthest-moving vertices of both, in the
/// frame of the mean motion. first_count: vertices of the first primitive (1 or 2).
double motion_bound(const std::array<Eigen::Vector3d, 4>& start, const std::array<Eigen::Vector3d, 4>& end,
                    int first_count);

}  // namespace pleat
