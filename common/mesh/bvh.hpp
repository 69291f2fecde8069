// A bounding volume hierarchy whose tree is built once and whose boxes are refitted as the mesh moves.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"

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
    constexpr double kSlack = 1 + 1e-12;
    std::pair<std::uint32_t, double> stack[64];
    int size = 0;
    stack[size++] = {0, squared_distance(boxes_[0], p)};
    while (size > 0) {
      const auto [node, distance] = stack[--size];
      if (distance > bound * kSlack) continue;
      if (nodes_[node].element != kInner) {
        bound = visit(nodes_[node].element);
        continue;
      }
      const std::uint32_t left = node + 1, right = nodes_[node].right;
      const double to_left = squared_distance(boxes_[left], p), to_right = squared_distance(boxes_[right], p);
      const bool left_first = to_left <= to_right;
      stack[size++] = left_first ? std::pair(right, to_right) : std::pair(left, to_left);
      stack[size++] = left_first ? std::pair(left, to_left) : std::pair(right, to_right);
    }
  }

  /// Calls visit(element) for every element whose box overlaps the box.
  template <typename Visit>
  void query(const Box& box, const Visit& visit) const {
    if (empty()) return;
    std::uint32_t stack[64];
    int size = 0;
    stack[size++] = 0;
    while (size > 0) {
      const std::uint32_t node = stack[--size];
      if (!boxes_[node].overlaps(box)) continue;
      if (nodes_[node].element != kInner) {
        visit(nodes_[node].element);
      } else {
        stack[size++] = nodes_[node].right;
        stack[size++] = node + 1;
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

  std::uint32_t build(std::span<const Box> boxes, std::span<std::uint32_t> elements);

  std::vector<Node> nodes_;
  std::vector<Box> boxes_;              // one per node
  std::vector<std::uint32_t> leaf_of_;  // node of an element
};

}  // namespace pleat
