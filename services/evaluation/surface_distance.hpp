// Distance from points to a triangle surface, and the Hausdorff distance between two surfaces of one topology.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/mesh/bvh.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::evaluation {

/// The faces of one surface, to be asked for distances. Immutable: queries may run in several threads.
class SurfaceDistance {
 public:
  /// positions: (V x 3) metres. Throws kInvalidArgument without faces. O(F log F).
  SurfaceDistance(const Faces& faces, const Positions& positions);

  /// Squared distance from p to the surface, if it is below `squared_bound`; otherwise `squared_bound`.
  double squared_distance(const Eigen::Vector3d& p, double squared_bound) const;

 private:
  Faces faces_;
  std::vector<Eigen::Vector3d> points_;
  Bvh hierarchy_;
};

/// Symmetric Hausdorff distance between two surfaces with the same faces, taken at the vertices of both: the largest
/// distance from a vertex of one to the surface of the other, metres. a, b: (V x 3).
/// Throws kInvalidArgument for different sizes or no faces.
double hausdorff_distance(const Faces& faces, const Positions& a, const Positions& b);

}  // namespace pleat::evaluation
