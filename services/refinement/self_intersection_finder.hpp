// Finds all pairs of faces of a moving mesh that intersect. One per session: the tree and the neighbourhoods are built
// once, boxes are refitted per frame.
//
// Most pairs whose boxes overlap are neighbours on a smooth sheet. They are excluded in bulk, and safely: if all faces
// of the patches around one patch corner have a positive normal along a common direction, and the outline of these
// patches, seen along it, is star-shaped, then the projection is one-to-one, so no two of these faces intersect beyond
// what they share.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/bvh.hpp"
#include "common/mesh/mesh.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::refinement {

class SelfIntersectionFinder {
 public:
  /// patch_corners: (P x 3); patch p are the faces [p k, (p+1) k) with k = F / P, and together they are the split of
  /// the coarse face patch_corners[p] whose corners keep their indices. The faces themselves (P = F) are always
  /// allowed. pool: may be null. Throws kInvalidArgument for an index out of range or an F that P does not divide.
  SelfIntersectionFinder(const Faces& faces, Eigen::Index vertex_count, const Faces& patch_corners,
                         ThreadPool* pool = nullptr);
  SelfIntersectionFinder(const Faces& faces, Eigen::Index vertex_count)
      : SelfIntersectionFinder(faces, vertex_count, faces) {}

  const Faces& faces() const { return faces_; }

  /// New boxes. positions: (V x 3), finite. The first call builds the tree.
  void update(const Positions& positions);

  /// Replaces `pairs` by the intersecting pairs (first < second, ascending) of the positions of the last update. Stops
  /// after `limit` pairs and returns false if there were more; which ones are left out is not specified. Keeps its
  /// memory.
  bool find(const Positions& positions, std::size_t limit, std::vector<FacePair>& pairs);

  /// The same, where all but the vertices of some patches (each named once) are where they were when find() or
  /// find_again() completed `pairs`. Brings the boxes up to date, too.
  bool find_again(const Positions& positions, std::span<const std::uint32_t> moved_patches, std::size_t limit,
                  std::vector<FacePair>& pairs);

  /// Calls visit(face) for every face whose box overlaps `box`.
  template <typename Visit>
  void query(const Box& box, const Visit& visit) const {
    tree_.query(box, [&](std::uint32_t patch) {
      for (std::uint32_t f = patch * patch_size_; f < (patch + 1) * patch_size_; ++f) {
        if (boxes_[f].overlaps(box)) visit(f);
      }
    });
  }

  /// The box of a face as of the last update.
  const Box& box(std::uint32_t face) const { return boxes_[face]; }

  /// Calls visit(patch) for every patch whose box overlaps `box`.
  template <typename Visit>
  void query_patches(const Box& box, const Visit& visit) const {
    tree_.query(box, visit);
  }
  const Box& patch_box(std::uint32_t patch) const { return patch_boxes_[patch]; }
  std::uint32_t patch_of(std::uint32_t face) const { return face / patch_size_; }
  std::uint32_t patch_count() const { return static_cast<std::uint32_t>(patch_boxes_.size()); }
  /// The patches with a vertex, ascending.
  std::span<const std::uint32_t> patches_at(std::uint32_t vertex) const {
    return std::span(vertex_patches_)
        .subspan(vertex_patch_offsets_[vertex], vertex_patch_offsets_[vertex + 1] - vertex_patch_offsets_[vertex]);
  }
  /// [first, last).
  std::pair<std::uint32_t, std::uint32_t> patch_faces(std::uint32_t patch) const {
    return {patch * patch_size_, (patch + 1) * patch_size_};
  }

 private:
  // The patches around a patch corner and their outline, counter-clockwise edges.
  struct Umbrella {
    std::uint32_t first_patch, patch_count;
    std::uint32_t first_edge, edge_count;
  };
  void build_umbrellas(Eigen::Index vertex_count);
  void fit_patch(std::uint32_t patch);
  void refit();
  void build_incidence(Eigen::Index vertex_count);
  bool is_injective(const Umbrella& umbrella, const Positions& positions) const;
  bool excluded(std::uint32_t patch_a, std::uint32_t patch_b) const;
  void measure_normals(const Positions& positions, std::size_t first_face, std::size_t last_face);
  void update_patches(const Positions& positions, std::span<const std::uint32_t> patches);

  // What one part of the search found. `stack` is its traversal, `near` the faces of a patch near another one.
  struct Part {
    std::vector<Bvh::Pair> stack;
    std::vector<FacePair> pairs;
    std::vector<std::uint32_t> near;
  };
  class Search;

  ThreadPool* pool_;
  Faces faces_;
  Faces patch_corners_;
  std::uint32_t patch_size_ = 1;
  std::vector<Box> boxes_;           // of faces
  std::vector<Box> patch_boxes_;     // of patches
  Bvh tree_;                         // over patches; built by the first update
  std::vector<Umbrella> umbrellas_;  // one per vertex; edge_count 0 if there is none to test
  std::vector<std::uint32_t> umbrella_patches_;
  std::vector<std::array<std::uint32_t, 2>> outlines_;
  std::vector<Bvh::Pair> tree_parts_;  // of the traversal; made with the tree
  // Of the last find(): normals of twice the area with a bound of the product of the edge lengths that they come from,
  // one per face; whether the projection of an umbrella is one-to-one.
  std::vector<std::array<float, 4>> normals_;
  std::vector<std::uint8_t> injective_;
  std::vector<Part> parts_;
  std::vector<std::uint32_t> vertex_patch_offsets_, vertex_patches_;
  std::vector<std::uint8_t> is_moved_, corner_used_;
  std::vector<std::uint32_t> corners_;  // of moved patches
  std::vector<std::uint32_t> near_;     // as in Part
};

}  // namespace pleat::refinement
