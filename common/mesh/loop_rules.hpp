// What Loop's rules (1987) have to know of a mesh with a boundary.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/mesh/connectivity.hpp"

namespace pleat {

/// The two neighbours of every vertex along the boundary; kNone where there is no boundary, or more than one.
using BoundaryNeighbours = std::vector<std::array<std::uint32_t, 2>>;
BoundaryNeighbours boundary_neighbours(Eigen::Index vertices, const Connectivity& mesh);

/// Of each vertex: 1 where it stays, because the boundary turns there by more than 45 degrees, or several meet.
std::vector<char> find_corners(const Positions& positions, const Faces& faces);

/// The weight of each of the `valence` neighbours of a vertex inside; its own is 1 less all of them.
double loop_neighbour_weight(int valence);

}  // namespace pleat
