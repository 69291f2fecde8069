// Edges, hinges and neighbourhoods of a triangle mesh, computed once per topology.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

inline constexpr std::uint32_t kNone = 0xffffffffu;

/// An edge with its faces. Vertices v0 -> v1 run as in face f0 (counter-clockwise); f1 is kNone on the boundary.
/// opposite0 and opposite1 are the vertices of f0 and f1 that are not on the edge.
struct Edge {
  std::uint32_t v0, v1;
  std::uint32_t f0, f1;
  std::uint32_t opposite0, opposite1;
};

struct Connectivity {
  std::vector<Edge> edges;                               ///< ordered by first appearance in face order: deterministic
  std::vector<std::array<std::uint32_t, 3>> face_edges;  ///< edge k of a face joins its corners k and (k+1)%3
  std::vector<std::uint32_t> vertex_face_offsets;        ///< (V+1) compressed rows into vertex_faces
  std::vector<std::uint32_t> vertex_faces;               ///< faces at a vertex, ascending
};

/// Needs a topology that passed validate_topology (manifold edges). O(F).
Connectivity build_connectivity(Eigen::Index vertex_count, const Faces& faces);

/// Mean length of the faces' sides in the rest mesh, metres; sides of two faces count twice. 0 without faces. O(F).
double mean_edge_length(const Topology& topology);

/// Number of connected components (by shared vertices) among the vertices that faces use.
int count_components(Eigen::Index vertex_count, const Faces& faces);

}  // namespace pleat
