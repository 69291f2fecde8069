#include "common/mesh/swept_bvh.hpp"

#include <algorithm>
#include <numeric>
#include <string>
#include <utility>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr std::size_t kLeafGrain = 256;

// Lanes of b (all at once) that may meet lane i of a.
template <typename Leaf>
std::uint32_t meeting(const Leaf& a, std::size_t i, const Leaf& b) {
  const Float8 zero{};
  Int8 apart{};
  for (std::size_t k = 0; k < 3; ++k) {
    const int lane = static_cast<int>(i);
    const Float8 back = min(zero, a.motion_lower[k][lane] - b.motion_upper[k]);
    const Float8 forth = max(zero, a.motion_upper[k][lane] - b.motion_lower[k]);
    apart |= (a.lower[k][lane] + back > b.upper[k]) | (a.upper[k][lane] + forth < b.lower[k]);
  }
  return ~bits(apart) & 0xffu;
}

// Lanes of b that may meet a box.
template <typename Leaf>
std::uint32_t meeting(const SweptBox& box, const Leaf& b) {
  const Float8 zero{};
  Int8 apart{};
  for (std::size_t k = 0; k < 3; ++k) {
    const int axis = static_cast<int>(k);
    const Float8 back = min(zero, box.motion_lower[axis] - b.motion_upper[k]);
    const Float8 forth = max(zero, box.motion_upper[axis] - b.motion_lower[k]);
    apart |= (box.lower[axis] + back > b.upper[k]) | (box.upper[axis] + forth < b.lower[k]);
  }
  return ~bits(apart) & 0xffu;
}

// Lanes of b whose face has a vertex in common with face i of a.
template <typename Leaf>
std::uint32_t sharing(const Leaf& a, std::size_t i, const Leaf& b) {
  Int8 shared{};
  for (std::size_t k = 0; k < 3; ++k) {
    const auto v = static_cast<std::int32_t>(a.vertices[k][i]);
    for (std::size_t m = 0; m < 3; ++m) shared |= load_as<Int8>(b.vertices[m].data()) == v;
  }
  return bits(shared);
}

}  // namespace

SweptBvh::SweptBvh(std::span<const std::array<std::uint32_t, 3>> faces, std::span<const Eigen::Vector3d> positions) {
  if (faces.empty()) return;
  std::vector<Eigen::Vector3d> centers(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f)
    centers[f] = positions[faces[f][0]] + positions[faces[f][1]] + positions[faces[f][2]];
  std::vector<std::uint32_t> elements(faces.size());
  std::iota(elements.begin(), elements.end(), 0u);
  build(faces, centers, elements);
  boxes_.resize(nodes_.size());
  node_of_leaf_.resize(leaves_.size());
  for (std::uint32_t n = 0; n < nodes_.size(); ++n) {
    if (nodes_[n].leaf != kInner) node_of_leaf_[nodes_[n].leaf] = n;
  }
}

void SweptBvh::build(std::span<const std::array<std::uint32_t, 3>> faces, std::span<const Eigen::Vector3d> centers,
                     std::span<std::uint32_t> elements) {
  const std::size_t node = nodes_.size();
  nodes_.emplace_back();
  if (elements.size() <= kWidth) {
    nodes_[node].leaf = static_cast<std::uint32_t>(leaves_.size());
    Leaf& leaf = leaves_.emplace_back();
    leaf.count = static_cast<std::uint32_t>(elements.size());
    for (std::size_t i = 0; i < kWidth; ++i) {
      const bool used = i < elements.size();
      leaf.faces[i] = used ? elements[i] : kInner;
      for (std::size_t k = 0; k < 3; ++k) leaf.vertices[k][i] = used ? faces[elements[i]][k] : kInner;
    }
    return;
  }
  Eigen::Vector3d low = centers[elements[0]], high = low;
  for (const std::uint32_t e : elements) {
    low = low.cwiseMin(centers[e]);
    high = high.cwiseMax(centers[e]);
  }
  Eigen::Index axis = 0;
  (high - low).maxCoeff(&axis);
  // Full leaves: the left half is a multiple of the width.
  const std::size_t half = (elements.size() / 2 + kWidth - 1) / kWidth * kWidth;
  std::nth_element(elements.begin(), elements.begin() + static_cast<std::ptrdiff_t>(half), elements.end(),
                   [&](std::uint32_t a, std::uint32_t b) {
                     return centers[a][axis] < centers[b][axis] || (centers[a][axis] == centers[b][axis] && a < b);
                   });
  build(faces, centers, elements.first(half));
  nodes_[node].right = static_cast<std::uint32_t>(nodes_.size());
  build(faces, centers, elements.subspan(half));
}

void SweptBvh::refit_leaf(std::size_t l, std::span<const SweptBox> points) {
  Leaf& leaf = leaves_[l];
  SweptBox all;
  Float4 lower[kWidth], upper[kWidth], motion_lower[kWidth], motion_upper[kWidth];
  for (std::size_t i = 0; i < kWidth; ++i) {
    SweptBox box;
    if (i < leaf.count) {
      for (std::size_t k = 0; k < 3; ++k) box.extend(points[leaf.vertices[k][i]]);
      all.extend(box);
    }
    lower[i] = box.lower;
    upper[i] = box.upper;
    motion_lower[i] = i < leaf.count ? box.motion_lower : Float4{};
    motion_upper[i] = i < leaf.count ? box.motion_upper : Float4{};
  }
  const auto by_axis = [](const Float4(&lanes)[kWidth], std::array<Float8, 3>& axes) {
    Float8 columns[4];
    transpose(lanes, columns);
    std::copy(columns, columns + 3, axes.begin());
  };
  by_axis(lower, leaf.lower);
  by_axis(upper, leaf.upper);
  by_axis(motion_lower, leaf.motion_lower);
  by_axis(motion_upper, leaf.motion_upper);
  boxes_[node_of_leaf_[l]] = all;
}

// Inner nodes in [first, last), of whose children's boxes those outside are right.
void SweptBvh::refit_nodes(std::size_t first, std::size_t last) {
  for (std::size_t n = last; n-- > first;) {
    if (nodes_[n].leaf != kInner) continue;
    SweptBox box = boxes_[n + 1];
    box.extend(boxes_[nodes_[n].right]);
    boxes_[n] = box;
  }
}

void SweptBvh::refit(std::span<const SweptBox> points, ThreadPool& pool) {
  pool.parallel_for(leaves_.size(), kLeafGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t l = begin; l < end; ++l) refit_leaf(l, points);
  });
  refit_nodes(0, nodes_.size());
}

void SweptBvh::find_blocks() {
  std::vector<std::uint32_t> seen;  // per vertex: the last block with it, counted from 1
  const auto add = [&](std::uint32_t first_node, std::uint32_t last_node) {
    Block block{first_node, last_node, kInner, 0, static_cast<std::uint32_t>(block_vertices_.size()), 0};
    const auto number = static_cast<std::uint32_t>(blocks_.size() + 1);
    for (std::uint32_t n = first_node; n < last_node; ++n) {
      const std::uint32_t l = nodes_[n].leaf;
      if (l == kInner) continue;
      block.first_leaf = std::min(block.first_leaf, l);
      block.last_leaf = l + 1;
      for (std::size_t i = 0; i < leaves_[l].count; ++i) {
        for (std::size_t k = 0; k < 3; ++k) {
          const std::uint32_t v = leaves_[l].vertices[k][i];
          if (v >= seen.size()) seen.resize(v + 1, 0);
          if (std::exchange(seen[v], number) != number) block_vertices_.push_back(v);
        }
      }
    }
    block.last_vertex = static_cast<std::uint32_t>(block_vertices_.size());
    blocks_.push_back(block);
  };
  // A subtree is a range of nodes, and has one inner node less than leaves.
  const auto split = [&](auto& self, std::uint32_t node, std::uint32_t last) -> void {
    if (last - node < 2 * kBlockLeaves) return add(node, last);
    self(self, node + 1, nodes_[node].right);
    self(self, nodes_[node].right, last);
  };
  split(split, 0, static_cast<std::uint32_t>(nodes_.size()));
}

// Whether a leaf may meet the box.
bool SweptBvh::meets(const SweptBox& box) const {
  std::uint32_t stack[64];  // one for each level, and one
  std::size_t size = 0;
  stack[size++] = 0;
  while (size > 0) {
    const std::uint32_t n = stack[--size];
    if (!boxes_[n].may_meet(box)) continue;
    if (nodes_[n].leaf != kInner) return true;
    stack[size++] = nodes_[n].right;
    stack[size++] = n + 1;
  }
  return false;
}

void SweptBvh::refit(std::span<const SweptBox> points, const SweptBvh& other) {
  if (empty()) return;
  if (blocks_.empty()) find_blocks();
  for (const Block& block : blocks_) {
    SweptBox all;
    for (std::uint32_t i = block.first_vertex; i < block.last_vertex; ++i) all.extend(points[block_vertices_[i]]);
    if (other.empty() || !other.meets(all)) {
      boxes_[block.first_node] = SweptBox();  // which nothing meets
      continue;
    }
    for (std::size_t l = block.first_leaf; l < block.last_leaf; ++l) refit_leaf(l, points);
    refit_nodes(block.first_node, block.last_node);
  }
  // The nodes above; those of the blocks are ready.
  for (std::size_t b = blocks_.size(), last = nodes_.size(); b-- > 0;) {
    refit_nodes(blocks_[b].last_node, last);
    last = blocks_[b].first_node;
    if (b == 0) refit_nodes(0, last);
  }
}

SweptBox SweptBvh::lane_box(const Leaf& leaf, std::size_t i) const {
  const int lane = static_cast<int>(i);
  const auto gather = [lane](const std::array<Float8, 3>& v) { return Float4{v[0][lane], v[1][lane], v[2][lane], 0}; };
  SweptBox box;
  box.lower = gather(leaf.lower);
  box.upper = gather(leaf.upper);
  box.motion_lower = gather(leaf.motion_lower);
  box.motion_upper = gather(leaf.motion_upper);
  return box;
}

void SweptBvh::leaf_pairs(std::uint32_t p, std::uint32_t q, bool neighbours, std::vector<Pair>& out) const {
  const Leaf &a = leaves_[nodes_[p].leaf], &b = leaves_[nodes_[q].leaf];
  // Most faces of neighbouring leaves are far from the other leaf: one look at all of them.
  const std::uint32_t near_b = p == q ? 0xffu : meeting(boxes_[p], b);
  for (std::uint32_t rows = p == q ? 0xffu : meeting(boxes_[q], a); rows != 0 && near_b != 0; rows &= rows - 1) {
    const auto i = static_cast<std::size_t>(__builtin_ctz(rows));
    std::uint32_t lanes = near_b & meeting(a, i, b);
    if (p == q) lanes &= ~((2u << i) - 1);
    if (lanes == 0) continue;
    if (!neighbours) lanes &= ~sharing(a, i, b);
    for (; lanes != 0; lanes &= lanes - 1) {
      const std::uint32_t f = a.faces[i], g = b.faces[static_cast<std::size_t>(__builtin_ctz(lanes))];
      out.push_back(std::minmax(f, g));
    }
  }
}

// Pairs below two nodes; the same node twice means pairs inside it.
void SweptBvh::collide(std::uint32_t a, std::uint32_t b, std::size_t limit, bool neighbours,
                       std::vector<Pair>& out) const {
  std::vector<Pair> stack{{a, b}};
  while (!stack.empty() && out.size() <= limit) {
    const auto [p, q] = stack.back();
    stack.pop_back();
    const bool leaf_p = nodes_[p].leaf != kInner, leaf_q = nodes_[q].leaf != kInner;
    if (p == q) {
      if (leaf_p) {
        leaf_pairs(p, p, neighbours, out);
        continue;
      }
      stack.push_back({p + 1, nodes_[p].right});
      stack.push_back({nodes_[p].right, nodes_[p].right});
      stack.push_back({p + 1, p + 1});
      continue;
    }
    if (!boxes_[p].may_meet(boxes_[q])) continue;
    if (leaf_p && leaf_q) {
      leaf_pairs(p, q, neighbours, out);
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
}

std::vector<SweptBvh::Pair> SweptBvh::self_pairs(ThreadPool& pool, std::size_t limit, bool neighbours) const {
  if (empty()) return {};
  // Tasks: the tree's upper levels unfolded, always the same way, so that the order of the result is fixed.
  std::vector<Pair> tasks{{0, 0}};
  const int rounds = leaves_.size() > 512 ? 5 : 0;
  for (int round = 0; round < rounds; ++round) {
    std::vector<Pair> next;
    for (const auto& [p, q] : tasks) {
      const bool inner_p = nodes_[p].leaf == kInner, inner_q = nodes_[q].leaf == kInner;
      if (p == q && inner_p) {
        next.push_back({p + 1, p + 1});
        next.push_back({p + 1, nodes_[p].right});
        next.push_back({nodes_[p].right, nodes_[p].right});
      } else if (p != q && !boxes_[p].may_meet(boxes_[q])) {
        continue;
      } else if (p != q && inner_p && inner_q) {
        for (const std::uint32_t a : {p + 1, nodes_[p].right}) {
          for (const std::uint32_t b : {q + 1, nodes_[q].right}) next.push_back({a, b});
        }
      } else {
        next.push_back({p, q});
      }
    }
    tasks = std::move(next);
  }
  std::vector<std::vector<Pair>> results(tasks.size());
  pool.parallel_for(tasks.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) collide(tasks[i].first, tasks[i].second, limit, neighbours, results[i]);
  });
  std::size_t total = 0;
  for (const auto& r : results) total += r.size();
  if (total > limit) {
    throw Error(ErrorCode::kResourceExhausted,
                "more than " + std::to_string(limit) + " pairs of faces are near each other");
  }
  if (results.size() == 1) return std::move(results.front());
  std::vector<Pair> out;
  out.reserve(total);
  for (const auto& r : results) out.insert(out.end(), r.begin(), r.end());
  return out;
}

std::vector<SweptBvh::Pair> SweptBvh::pairs(const SweptBvh& other) const {
  std::vector<Pair> out;
  append_pairs(other, out);
  return out;
}

void SweptBvh::append_pairs(const SweptBvh& other, std::vector<Pair>& out) const {
  if (empty() || other.empty()) return;
  std::vector<Pair> stack{{0, 0}};
  while (!stack.empty()) {
    const auto [p, q] = stack.back();
    stack.pop_back();
    if (!boxes_[p].may_meet(other.boxes_[q])) continue;
    const bool leaf_p = nodes_[p].leaf != kInner, leaf_q = other.nodes_[q].leaf != kInner;
    if (leaf_p && leaf_q) {
      const Leaf &a = leaves_[nodes_[p].leaf], &b = other.leaves_[other.nodes_[q].leaf];
      // As in leaf_pairs(): most faces of either leaf are far from the other leaf.
      const std::uint32_t near_b = meeting(boxes_[p], b);
      for (std::uint32_t rows = meeting(other.boxes_[q], a); rows != 0 && near_b != 0; rows &= rows - 1) {
        const auto i = static_cast<std::size_t>(__builtin_ctz(rows));
        for (std::uint32_t lanes = near_b & meeting(a, i, b); lanes != 0; lanes &= lanes - 1)
          out.push_back({a.faces[i], b.faces[static_cast<std::size_t>(__builtin_ctz(lanes))]});
      }
    } else if (leaf_p) {
      stack.push_back({p, other.nodes_[q].right});
      stack.push_back({p, q + 1});
    } else {
      stack.push_back({nodes_[p].right, q});
      stack.push_back({p + 1, q});
    }
  }
}

std::vector<std::uint32_t> SweptBvh::query(const SweptBox& box) const {
  std::vector<std::uint32_t> out;
  if (empty()) return out;
  std::vector<std::uint32_t> stack{0};
  while (!stack.empty()) {
    const std::uint32_t n = stack.back();
    stack.pop_back();
    if (!boxes_[n].may_meet(box)) continue;
    if (nodes_[n].leaf == kInner) {
      stack.push_back(nodes_[n].right);
      stack.push_back(n + 1);
      continue;
    }
    const Leaf& leaf = leaves_[nodes_[n].leaf];
    for (std::size_t i = 0; i < leaf.count; ++i) {
      if (lane_box(leaf, i).may_meet(box)) out.push_back(leaf.faces[i]);
    }
  }
  std::sort(out.begin(), out.end());
  return out;
}

}  // namespace pleat
