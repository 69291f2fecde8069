// A hierarchy over moving triangles for continuous collision detection.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/base/simd.hpp"

namespace pleat {

/// Where a set of points starts, and by how much they move in the step: two boxes. Two sets can't come near each other
/// when the start of one, widened by the motion *relative* to the other, misses the start of the other. So common
/// motion, however fast, makes no pairs.
struct SweptBox {
  Float4 lower = broadcast4(3e38f), upper = broadcast4(-3e38f);
  Float4 motion_lower = broadcast4(3e38f), motion_upper = broadcast4(-3e38f);

  SweptBox() = default;
  /// Everything within `margin` of a point on its way.
  SweptBox(const Eigen::Vector3d& start, const Eigen::Vector3d& end, double margin) {
    const Eigen::Vector3d motion = end - start;
    // Float32 rounds a value by 2^-24 of it at most; the sums of may_meet() round a few times more.
    const Eigen::Vector3d around = (4e-7 * (start.cwiseAbs() + motion.cwiseAbs())).array() + (margin + 1e-30);
    lower = to_float4(Eigen::Vector3d(start - around));
    upper = to_float4(Eigen::Vector3d(start + around));
    motion_lower = motion_upper = to_float4(motion);
  }

  void extend(const SweptBox& other) {
    lower = min(lower, other.lower);
    upper = max(upper, other.upper);
    motion_lower = min(motion_lower, other.motion_lower);
    motion_upper = max(motion_upper, other.motion_upper);
  }
  bool may_meet(const SweptBox& other) const {
    const Float4 zero{};
    const Float4 back = min(zero, motion_lower - other.motion_upper);
    const Float4 forth = max(zero, motion_upper - other.motion_lower);
    return !any((lower + back > other.upper) | (upper + forth < other.lower));
  }
};

/// The tree is built once and refitted every step. Results do not depend on the number of threads.
class SweptBvh {
 public:
  using Pair = std::pair<std::uint32_t, std::uint32_t>;

  SweptBvh() = default;
  /// positions: any state of the mesh; near there means near in the tree. O(n log n).
  SweptBvh(std::span<const std::array<std::uint32_t, 3>> faces, std::span<const Eigen::Vector3d> positions);

  bool empty() const { return leaves_.empty(); }

  /// points: the swept boxes of all vertices. O(n).
  void refit(std::span<const SweptBox> points, ThreadPool& pool);

  /// The same where only what may meet the other hierarchy, which is fitted to its own points, matters: all else is
  /// left out of pairs() and query() until the next refit. O(n), and cheaper the less there is.
  void refit(std::span<const SweptBox> points, const SweptBvh& other);

  /// Pairs (i < j) of faces that may meet; those with a common vertex only if `neighbours`. Throws kResourceExhausted
  /// beyond `limit`.
  std::vector<Pair> self_pairs(ThreadPool& pool, std::size_t limit, bool neighbours = false) const;
  /// Pairs (i of this, j of other).
  std::vector<Pair> pairs(const SweptBvh& other) const;
  /// The same, appended.
  void append_pairs(const SweptBvh& other, std::vector<Pair>& out) const;
  /// Faces that may meet the box, ascending.
  std::vector<std::uint32_t> query(const SweptBox& box) const;

 private:
  static constexpr std::size_t kWidth = 8;
  // Faces side by side, one per lane; lanes without a face have an empty box.
  struct Leaf {
    std::array<Float8, 3> lower, upper, motion_lower, motion_upper;
    std::array<std::array<std::uint32_t, kWidth>, 3> vertices;
    std::array<std::uint32_t, kWidth> faces;
    std::uint32_t count = 0;
  };
  // Depth-first: the left child follows its parent.
  struct Node {
    std::uint32_t right = 0;
    std::uint32_t leaf = kInner;
  };
  static constexpr std::uint32_t kInner = 0xffffffffu;
  // A subtree of up to kBlockLeaves leaves, and the vertices of its faces, each once.
  struct Block {
    std::uint32_t first_node, last_node, first_leaf, last_leaf, first_vertex, last_vertex;
  };
  static constexpr std::uint32_t kBlockLeaves = 16;

  void build(std::span<const std::array<std::uint32_t, 3>> faces, std::span<const Eigen::Vector3d> centers,
             std::span<std::uint32_t> elements);
  void collide(std::uint32_t p, std::uint32_t q, std::size_t limit, bool neighbours, std::vector<Pair>& out) const;
  void leaf_pairs(std::uint32_t p, std::uint32_t q, bool neighbours, std::vector<Pair>& out) const;
  void refit_leaf(std::size_t l, std::span<const SweptBox> points);
  void refit_nodes(std::size_t first, std::size_t last);
  void find_blocks();
  bool meets(const SweptBox& box) const;
  SweptBox lane_box(const Leaf& leaf, std::size_t i) const;

  std::vector<Node> nodes_;
  std::vector<SweptBox> boxes_;
  std::vector<Leaf> leaves_;
  std::vector<std::uint32_t> node_of_leaf_;
  std::vector<Block> blocks_;  // together they have all leaves; found by the first refit that needs them
  std::vector<std::uint32_t> block_vertices_;
};

}  // namespace pleat
