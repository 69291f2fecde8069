// A bounding volume hierarchy whose tree is built once and whose boxes are refitted as the mesh moves.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/base/simd.hpp"

namespace pleat {

/// Axis-aligned box in float32, rounded outwards so that it contains the double points it was made from. The fourth
/// lane is unused; it makes the box two vector registers.
struct alignas(16) Box {
  float lower[4] = {3e38f, 3e38f, 3e38f, 0};
  float upper[4] = {-3e38f, -3e38f, -3e38f, 0};

  /// Contains p and everything closer than `margin` to it.
  void extend(const Eigen::Vector3d& p, double margin = 0) {
    for (int k = 0; k < 3; ++k) {
      // One float rounding is at most 2^-24 of the value; twice that is safely outside.
      const double slack = margin + 1.2e-7 * (p[k] < 0 ? -p[k] : p[k]) + 1e-30;
      const float low = static_cast<float>(p[k] - slack), high = static_cast<float>(p[k] + slack);
      lower[k] = low < lower[k] ? low : lower[k];
      upper[k] = high > upper[k] ? high : upper[k];
    }
  }
  void extend(const Box& other) {
    const Lanes low = lanes(lower), high = lanes(upper), other_low = lanes(other.lower),
                other_high = lanes(other.upper);
    const Lanes new_low = other_low < low ? other_low : low, new_high = other_high > high ? other_high : high;
    __builtin_memcpy(lower, &new_low, sizeof(lower));
    __builtin_memcpy(upper, &new_high, sizeof(upper));
  }
  bool overlaps(const Box& other) const {
    const auto outside = (lanes(lower) > lanes(other.upper)) | (lanes(other.lower) > lanes(upper));
    using Halves = long long __attribute__((vector_size(16)));
    Halves halves;
    __builtin_memcpy(&halves, &outside, sizeof(halves));
    return (halves[0] | halves[1]) == 0;
  }

 private:
  // One register each: traversals are made of these comparisons.
  using Lanes = float __attribute__((vector_size(16)));
  static Lanes lanes(const float* values) {
    Lanes v;
    __builtin_memcpy(&v, values, sizeof(v));
    return v;
  }
};

/// Contains everything closer than `margin` to the box.
inline Box widened(const Box& box, double margin) {
  Box wide;
  for (const auto& corner : {box.lower, box.upper}) {
    wide.extend(
        Eigen::Vector3d(static_cast<double>(corner[0]), static_cast<double>(corner[1]), static_cast<double>(corner[2])),
        margin);
  }
  return wide;
}

/// The square of the distance of p to the box; 0 inside.
inline double squared_distance(const Box& box, const Eigen::Vector3d& p) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const double below = static_cast<double>(box.lower[k]) - p[k], above = p[k] - static_cast<double>(box.upper[k]);
    const double outside = std::max(std::max(below, above), 0.0);
    sum += outside * outside;
  }
  return sum;
}

/// The elements in an order in which every `size` of them, from the first on, are near each other: for the leaves of a
/// hierarchy that hold as many. O(n log n).
std::vector<std::uint32_t> near_groups(std::span<const Box> boxes, std::size_t size);

/// Hierarchy over elements (usually faces) given by their boxes. Results do not depend on the number of threads.
class Bvh {
 public:
  using Pair = std::pair<std::uint32_t, std::uint32_t>;

  Bvh() = default;
  /// Builds the tree by median splits of the boxes' centres and fits the boxes. O(n log n).
  explicit Bvh(std::span<const Box> boxes);

  std::size_t size() const { return leaf_of_.size(); }
  bool empty() const { return leaf_of_.empty(); }
  /// The box around everything. Needs a non-empty hierarchy.
  const Box& bounds() const { return boxes_.front(); }

  /// New boxes, same elements. O(n).
  void refit(std::span<const Box> boxes);

  /// Calls visit(i, j), i < j, for every pair of elements whose boxes overlap until it returns false. Needs no memory
  /// per pair, so that a mesh that has collapsed into one place can't exhaust it. Returns whether all were visited.
  template <typename Visit>
  bool visit_self_pairs(const Visit& visit) const {
    std::vector<Pair> stack;
    return empty() || visit_self_pairs({0, 0}, stack, visit);
  }

  /// visit_self_pairs in parts, for several threads: the parts depend on the tree alone, not on its boxes, and together
  /// give every pair once. stack: memory to reuse, one per thread.
  std::vector<Pair> self_pair_parts(int levels) const;
  template <typename Visit>
  bool visit_self_pairs(Pair part, std::vector<Pair>& stack, const Visit& visit) const {
    stack.assign(1, part);
    while (!stack.empty()) {
      const auto [p, q] = stack.back();
      stack.pop_back();
      if (p == q) {
        if (nodes_[p].element != kInner) continue;
        const std::uint32_t left = p + 1, right = nodes_[p].right;
        stack.push_back({left, right});
        stack.push_back({right, right});
        stack.push_back({left, left});
        continue;
      }
      if (!boxes_[p].overlaps(boxes_[q])) continue;
      const bool leaf_p = nodes_[p].element != kInner, leaf_q = nodes_[q].element != kInner;
      if (leaf_p && leaf_q) {
        const auto [i, j] = std::minmax(nodes_[p].element, nodes_[q].element);
        if (!visit(i, j)) return false;
      } else if (leaf_q) {
        stack.push_back({nodes_[p].right, q});
        stack.push_back({p + 1, q});
      } else if (leaf_p) {
        stack.push_back({p, nodes_[q].right});
        stack.push_back({p, q + 1});
      } else {
        stack.push_back({nodes_[p].right, nodes_[q].right});
        stack.push_back({nodes_[p].right, q + 1});
        stack.push_back({p + 1, nodes_[q].right});
        stack.push_back({p + 1, q + 1});
      }
    }
    return true;
  }

  /// Calls visit(element) for every element whose box is nearer to p than the root of `bound`, near boxes first. visit
  /// returns the new bound, a squared distance that never grows. Boxes whose distance equals the bound within rounding
  /// are visited, so that among equally near elements the choice is the caller's.
  template <typename Visit>
  void nearest(const Eigen::Vector3d& p, double bound, const Visit& visit) const {
    if (empty()) return;
    const NearPoint point(p);
    struct Entry {
      std::uint32_t child;
      float distance;
    };
    Entry stack[kStack];
    int size = 0;
    stack[size++] = {0, 0};
    while (size > 0) {
      const Entry entry = stack[--size];
      if (entry.distance > rounded_up(bound)) continue;
      if ((entry.child & kLeaf) != 0) {
        bound = visit(entry.child & ~kLeaf);
        continue;
      }
      const WideNode& node = wide_[entry.child];
      const Float8 distances = point.squared_distances(node);
      std::uint32_t lanes = bits(distances <= broadcast8(rounded_up(bound))) & node.lanes;
      const int first = size;
      for (; lanes != 0; lanes &= lanes - 1) {
        const int lane = __builtin_ctz(lanes);
        const Entry child{node.child[lane], distances[lane]};
        int place = size++;  // the nearest one on top
        for (; place > first && stack[place - 1].distance < child.distance; --place) stack[place] = stack[place - 1];
        stack[place] = child;
      }
    }
  }

  /// Calls visit(element) for every element whose box overlaps the box.
  template <typename Visit>
  void query(const Box& box, const Visit& visit) const {
    if (empty()) return;
    std::uint32_t stack[kStack];
    int size = 0;
    stack[size++] = 0;
    while (size > 0) {
      const std::uint32_t child = stack[--size];
      if ((child & kLeaf) != 0) {
        visit(child & ~kLeaf);
        continue;
      }
      const WideNode& node = wide_[child];
      Int8 overlap = node.lower[0] <= broadcast8(box.upper[0]);
      overlap &= node.upper[0] >= broadcast8(box.lower[0]);
      for (int k = 1; k < 3; ++k) {
        overlap &= (node.lower[k] <= broadcast8(box.upper[k])) & (node.upper[k] >= broadcast8(box.lower[k]));
      }
      for (std::uint32_t lanes = bits(overlap) & node.lanes; lanes != 0;) {
        const int lane = 31 - __builtin_clz(lanes);  // the first one on top
        lanes ^= 1u << lane;
        stack[size++] = node.child[lane];
      }
    }
  }

 private:
  static constexpr std::uint32_t kInner = 0xffffffffu;
  // Nodes are stored in depth-first order: the left child follows its parent.
  struct Node {
    std::uint32_t element = kInner;  // of a leaf
    std::uint32_t right = 0;         // of an inner node
  };

  // Three levels of the tree as one node with eight boxes, for nearest() and query(): one comparison for all of them.
  static constexpr std::uint32_t kLeaf = 0x80000000u;
  static constexpr int kStack = 128;  // 7 for each three of at most 32 levels, and 8
  struct WideNode {
    Float8 lower[3], upper[3];
    std::uint32_t child[8];  // a wide node, or an element with kLeaf; in the tree's order
    std::uint32_t node[8];   // of the tree
    std::uint32_t lanes;     // a bit for each child
  };
  // Distances of a double point to float boxes, in float, rounded down.
  class NearPoint {
   public:
    explicit NearPoint(const Eigen::Vector3d& p) {
      for (int k = 0; k < 3; ++k) {
        p_[k] = broadcast8(static_cast<float>(p[k]));
        slack_[k] = broadcast8(1.3e-7f * std::abs(p_[k][0]));
      }
    }
    Float8 squared_distances(const WideNode& node) const {
      Float8 sum{};
      for (int k = 0; k < 3; ++k) {
        const Float8 outside = max(node.lower[k] - p_[k], p_[k] - node.upper[k]);
        const Float8 least = max((1 - 2e-7f) * outside - slack_[k], Float8{});
        sum += least * least;
      }
      return (1 - 4e-7f) * sum;
    }

   private:
    Float8 p_[3], slack_[3];
  };
  static float rounded_up(double bound) {
    constexpr double kMost = 3.4e38;
    return bound < kMost ? static_cast<float>((1 + 1.3e-7) * bound) : std::numeric_limits<float>::infinity();
  }

  std::uint32_t build(std::span<const Box> boxes, std::span<std::uint32_t> elements);
  std::uint32_t widen(std::uint32_t node);
  void refit_wide();

  std::vector<Node> nodes_;
  std::vector<Box> boxes_;  // one per node
  std::vector<WideNode> wide_;
  std::vector<std::uint32_t> leaf_of_;  // node of an element
};

}  // namespace pleat
