// Distance from points to a triangle surface, and the Hausdorff distance between two surfaces of one topology.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::evaluation {

/// Squared distance from p to the triangle a, b, c (degenerate triangles included), m^2.
double squared_point_triangle_distance(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                       const Eigen::Vector3d& c);

/// A hierarchy of boxes over the faces of one surface. Immutable: queries may run in several threads.
class SurfaceDistance {
 public:
  /// positions: (V x 3) metres. Throws kInvalidArgument without faces. O(F log F).
  SurfaceDistance(const Faces& faces, const Positions& positions);

  /// Squared distance from p to the surface, if it is below `squared_bound`; otherwise `squared_bound`.
  double squared_distance(const Eigen::Vector3d& p, double squared_bound) const;

 private:
  struct Node {
    Eigen::AlignedBox3d box;
    std::uint32_t first = 0;  ///< a leaf: into order_; else the right child (the left one is the next node)
    std::uint32_t count = 0;  ///< 0: not a leaf
  };
  std::uint32_t build(std::uint32_t begin, std::uint32_t end, const std::vector<Eigen::Vector3d>& centroids);

  Faces faces_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<std::uint32_t> order_;
  std::vector<Node> nodes_;
};

/// Symmetric Hausdorff distance between two surfaces with the same faces, taken at the vertices of both: the largest
/// distance from a vertex of one to the surface of the other, metres. a, b: (V x 3).
/// Throws kInvalidArgument for different sizes or no faces.
double hausdorff_distance(const Faces& faces, const Positions& a, const Positions& b);

}  // namespace pleat::evaluation
