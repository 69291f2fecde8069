// The one-rings of a rest mesh, and the affine map that a frame makes of each (docs/vertex-features.md).
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::conversion {

/// Vertices that are worked on at a time.
inline constexpr std::size_t kRingPack = 8;

/// Eight 3 x 3 matrices, row-major.
using Matrix8 = std::array<Float8, 9>;

/// One deformation gradient T per vertex, by columns: columns[v][c] = T_v e_c; the fourth lane is unused.
struct GradientField {
  std::vector<std::array<Float4, 3>> columns;

  Eigen::Matrix3f at(std::size_t vertex) const;
  void set(std::size_t vertex, const Eigen::Matrix3f& gradient);
};

/// Everything that depends on the rest mesh alone. With p_ij = p_j - p_i, rest r_ij, neighbours N(i):
///   T_i = (sum_j w_ij p_ij r_ij^T + m_i n_i^T) C_i^-1,  C_i = sum_j w_ij r_ij r_ij^T + n_i n_i^T,
/// n_i, m_i the unit normals (sum of unit face normals) of rest and deformed mesh, times 0.3 of the mean one-ring
/// length of each, so that flat one-rings determine T too. w_ij = sqrt(exp c) for c <= 0, else sqrt(1 + c), with
/// c = (cot a + cot b) / 2; 1 where that is not finite or above 1e5. Immutable.
class OneRings {
 public:
  struct WeightedEdge {
    std::uint32_t a, b;
    float weight;  ///< w_ab
  };

  /// Throws kInvalidArgument, naming `name` and the vertex, for an unusable topology, a vertex of no face, and a
  /// one-ring whose rest positions lie on one line or in one point.
  OneRings(const Topology& topology, const std::string& name);

  std::size_t vertex_count() const { return vertex_count_; }
  std::size_t pack_count() const { return packs_.size(); }
  const std::vector<WeightedEdge>& edges() const { return edges_; }
  const Positions& rest_positions() const { return rest_positions_; }

  /// T of vertices [8 pack, 8 pack + 8); beyond the last vertex, its T again. positions: (V) with any fourth lane.
  Matrix8 gradients(std::size_t pack, const Float4* positions) const;

  /// All of them. field is resized.
  void gradients(const Float4* positions, GradientField& field) const;

 private:
  // One place in the rings of eight vertices, in counter-clockwise order; the first neighbour of a closed ring again at
  // its end. Places that a ring lacks repeat the vertex itself with zeros.
  struct Entry {
    std::array<std::uint32_t, kRingPack> vertex;
    Float8 gx, gy, gz;      // w_ij C_i^-1 r_ij
    Float8 counts, corner;  // 1: the neighbour counts in the mean length; a face joins it and the next one
  };
  struct Pack {
    std::array<std::uint32_t, kRingPack> centre;
    Float8 hx, hy, hz;    // C_i^-1 n_i
    Float8 normal_scale;  // 0.3 / neighbours
    std::uint32_t first, count;
  };
  struct Ring;

  void weigh_edges(const Topology& topology);
  void add_pack(const std::vector<Ring>& rings, std::size_t first_vertex);

  std::size_t vertex_count_;
  Positions rest_positions_;
  std::vector<WeightedEdge> edges_;
  std::vector<Pack> packs_;
  std::vector<Entry> entries_;
};

/// to[v] = Y-rotation of (positions[v] - origin) by `angle` radians, as (V) registers. Throws kInvalidArgument with
/// `name` and the vertex for a wrong number of positions, and for one that is not finite or 1e6 m away or more.
void load_positions(const Positions& positions, std::size_t vertex_count, float angle, const Eigen::Vector3f& origin,
                    const std::string& name, std::vector<Float4>& to);

}  // namespace pleat::conversion
