// Triangulations of flat pieces of cloth. Internal to this room.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "services/dataset/random.hpp"

namespace pleat::dataset {

using Points = std::vector<Eigen::Vector2d>;

/// How the vertices inside lie.
enum class Pattern {
  kSquare,     ///< on a grid, all diagonals alike
  kDiagonals,  ///< on a grid, diagonals by chance
  kHexagonal,  ///< rows half an edge apart: equilateral triangles
  kIrregular,  ///< by chance, no two nearer than about an edge
};

struct PlanarMesh {
  Points points;  ///< metres; the outline's come first, in its order
  std::vector<std::array<std::uint32_t, 3>> faces;
};

/// The polygon's sides, each cut into equal edges of about `edge`: counter-clockwise, beginning with the first corner.
/// A side is the polyline from one corner to the next.
Points cut_sides(const std::vector<Points>& sides, double edge);

/// Triangles of about `edge` within a simple polygon, whose points become vertices and its sides edges. Deterministic
/// for the state of `random`. Throws kInternal if none of several attempts gives triangles that cover the polygon
/// without slivers (an angle below 8 degrees). O(V^2).
PlanarMesh mesh_outline(const Points& outline, double edge, Pattern pattern, Random& random);

}  // namespace pleat::dataset
