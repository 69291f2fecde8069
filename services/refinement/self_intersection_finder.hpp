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

namespace pleat {

class SelfIntersectionFinder {
 public:
  /// patch_corners: (P x 3); patch p are the faces [p k, (p+1) k) with k = F / P, and together they are the split of
  /// the coarse face patch_corners[p] whose corners keep their indices. The faces themselves (P = F) are always
  /// allowed. Throws kInvalidArgument for an index out of range or an F that P does not divide.
  SelfIntersectionFinder(const Faces& faces, Eigen::Index vertex_count, const Faces& patch_corners);
  SelfIntersectionFinder(const Faces& faces, Eigen::Index vertex_count)
      : SelfIntersectionFinder(faces, vertex_count, faces) {}

  const Faces& faces() const { return faces_; }

  /// New boxes for all faces, or for some of them. positions: (V x 3), finite.
  void update(const Positions& positions);
  void update(const Positions& positions, std::span<const std::uint32_t> moved_faces);
  /// Boxes that hold both positions of each of these faces, so that the tree stays valid while they move between them.
  void update_swept(const Positions& start, const Positions& end, std::span<const std::uint32_t> moving_faces);

  /// Appends the intersecting pairs (first < second, ascending) of the positions of the last update. Stops after
  /// `limit` pairs and returns false if there were more.
  bool find(const Positions& positions, std::size_t limit, std::vector<FacePair>& out) const;

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

 private:
  // The patches around a patch corner and their outline, counter-clockwise edges.
  struct Umbrella {
    std::uint32_t first_patch, patch_count;
    std::uint32_t first_edge, edge_count;
  };
  void build_umbrellas(Eigen::Index vertex_count);
  void fit_patch(std::uint32_t patch);
  void refit();
  bool is_injective(const Umbrella& umbrella, const Positions& positions,
                    const std::vector<std::array<float, 4>>& normals) const;
  bool excluded(std::uint32_t patch_a, std::uint32_t patch_b, const std::vector<std::uint8_t>& injective) const;

  Faces faces_;
  Faces patch_corners_;
  std::uint32_t patch_size_ = 1;
  std::vector<Box> boxes_;           // of faces
  std::vector<Box> patch_boxes_;     // of patches
  Bvh tree_;                         // over patches; built by the first update
  std::vector<Umbrella> umbrellas_;  // one per vertex; edge_count 0 if there is none to test
  std::vector<std::uint32_t> umbrella_patches_;
  std::vector<std::array<std::uint32_t, 2>> outlines_;
};

}  // namespace pleat
