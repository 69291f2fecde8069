// Layers of cloth that lie on each other: which of them is above is read off the coarse cloth, which does not pass
// through itself, so that fine layers that have are sorted again.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/bvh.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::fold {

/// A fine vertex before a point of another layer: normal . (x_vertex - sum_k weights[k] x_face[k]) is at least gap.
struct LayerContact {
  std::uint32_t vertex;
  std::array<std::uint32_t, 3> face;  ///< fine vertices
  std::array<float, 3> weights;
  Float4 normal;  ///< unit, of the coarse cloth, towards the vertex
  float gap;      ///< m
};

/// Finds them. One per stream; keeps memory between frames, and no state.
class LayerFinder {
 public:
  /// subdivision: of `coarse`, by midpoints of edges as subdivide() numbers them.
  LayerFinder(const Topology& coarse, const Subdivision& subdivision);

  /// For each fine vertex, on either side, the nearest point of another layer of the upsampled coarse cloth that is
  /// nearer than `reach` (m), if it lies about across the cloth; gaps are `thickness` or what the coarse cloth has,
  /// whichever is less. From there the point goes to where the vertex stands before that layer of the fine cloth, along
  /// the normal, if that is not far. O(V_fine + pairs of near coarse faces). The result lives until the next call.
  std::span<const LayerContact> find(const Positions& coarse, std::span<const Float4> upsampled,
                                     std::span<const Float4> fine, float reach, float thickness);

  /// The fine vertices of a coarse face, ascending: each vertex belongs to one.
  std::span<const std::uint32_t> vertices_of(std::uint32_t coarse_face) const {
    return std::span(vertices_of_)
        .subspan(vertices_of_begin_[coarse_face],
                 vertices_of_begin_[coarse_face + 1] - vertices_of_begin_[coarse_face]);
  }

 private:
  void place_vertices(std::span<const Float4> upsampled);
  void measure_faces(const Positions& coarse, float reach);
  void meet_all(std::uint32_t own, std::uint32_t face, float reach);
  Eigen::Vector3d point_of(std::uint32_t slot) const;
  void meet(std::uint32_t slot, std::size_t side, std::uint32_t face);
  std::uint32_t descend(std::uint32_t face, std::array<float, 3>& weights) const;
  bool walk(const LayerContact& contact, std::span<const Float4> fine, std::uint32_t& face,
            std::array<float, 3>& weights) const;

  Faces coarse_faces_, fine_faces_;
  std::vector<std::array<std::uint32_t, 3>> fine_neighbours_;  // across the edge that starts at each corner, or kNone
  int rounds_ = 0;
  std::vector<std::uint32_t> vertices_of_begin_, vertices_of_;  // fine vertices by coarse face
  Bvh tree_;
  std::vector<Box> boxes_;
  // A coarse face: its plane, and the circle about its centre that holds it.
  struct FaceShape {
    std::array<Float4, 3> corners;
    Float4 normal, center;
    float radius;
  };
  std::vector<FaceShape> shapes_;
  // The vertices of a coarse face in blocks of eight lanes; a slot is a lane of a block. Lanes left over are far away.
  struct Block {
    Float8 x, y, z;
    Float8 bound[2];  // how far from a plane a nearer face can be, on either side of the vertex's layer
  };
  std::vector<std::uint32_t> blocks_begin_;  // of a coarse face
  std::vector<Block> blocks_;
  struct Nearest {
    double squared_distance;
    std::uint32_t face;
  };
  std::vector<std::array<Nearest, 2>> nearest_;  // per slot on either side
  std::vector<std::uint32_t> slots_;             // per vertex
  std::vector<LayerContact> contacts_;
};

}  // namespace pleat::fold
