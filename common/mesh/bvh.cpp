#include "common/mesh/bvh.hpp"

#include <algorithm>
#include <numeric>
#include <string>

#include "common/base/error.hpp"

namespace pleat {
namespace {

// Orders the elements so that along the axis in which their centres are spread most, none before the middle is beyond
// one after it.
void split_at(std::span<const Box> boxes, std::span<std::uint32_t> elements, std::size_t middle) {
  const auto center = [&](std::uint32_t e, int k) { return boxes[e].lower[k] + boxes[e].upper[k]; };
  float low[3] = {3e38f, 3e38f, 3e38f}, high[3] = {-3e38f, -3e38f, -3e38f};
  for (const std::uint32_t e : elements) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], center(e, k));
      high[k] = std::max(high[k], center(e, k));
    }
  }
  int axis = 0;
  for (int k = 1; k < 3; ++k) {
    if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
  }
  std::nth_element(elements.begin(), elements.begin() + static_cast<std::ptrdiff_t>(middle), elements.end(),
                   [&](std::uint32_t a, std::uint32_t b) {
                     const float ca = center(a, axis), cb = center(b, axis);
                     return ca < cb || (ca == cb && a < b);
                   });
}

void group(std::span<const Box> boxes, std::span<std::uint32_t> elements, std::size_t size) {
  if (elements.size() <= size) return;
  const std::size_t middle = (elements.size() / 2 + size - 1) / size * size;
  split_at(boxes, elements, middle);
  group(boxes, elements.first(middle), size);
  group(boxes, elements.subspan(middle), size);
}

}  // namespace

std::vector<std::uint32_t> near_groups(std::span<const Box> boxes, std::size_t size) {
  std::vector<std::uint32_t> elements(boxes.size());
  std::iota(elements.begin(), elements.end(), 0u);
  group(boxes, elements, size);
  return elements;
}

Bvh::Bvh(std::span<const Box> boxes) {
  if (boxes.empty()) return;
  if (boxes.size() > kLeaf) throw_internal("Bvh: more than 2^31 elements");
  nodes_.reserve(2 * boxes.size() - 1);
  leaf_of_.resize(boxes.size());
  std::vector<std::uint32_t> elements(boxes.size());
  std::iota(elements.begin(), elements.end(), 0u);
  build(boxes, elements);
  boxes_.resize(nodes_.size());
  widen(0);
  refit(boxes);
}

std::uint32_t Bvh::build(std::span<const Box> boxes, std::span<std::uint32_t> elements) {
  const auto node = static_cast<std::uint32_t>(nodes_.size());
  nodes_.emplace_back();
  if (elements.size() == 1) {
    nodes_[node].element = elements[0];
    leaf_of_[elements[0]] = node;
    return node;
  }
  const std::size_t middle = elements.size() / 2;
  split_at(boxes, elements, middle);
  build(boxes, elements.first(middle));
  const std::uint32_t right = build(boxes, elements.subspan(middle));
  nodes_[node].right = right;
  return node;
}

std::uint32_t Bvh::widen(std::uint32_t node) {
  const auto index = static_cast<std::uint32_t>(wide_.size());
  WideNode wide{};
  int count = 0;
  const auto gather = [&](auto& self, std::uint32_t at, int levels) -> void {
    if (levels == 0 || nodes_[at].element != kInner) {
      wide.node[count++] = at;
      return;
    }
    self(self, at + 1, levels - 1);
    self(self, nodes_[at].right, levels - 1);
  };
  gather(gather, node, 3);
  wide.lanes = (1u << count) - 1;
  wide_.emplace_back();
  for (int lane = 0; lane < count; ++lane) {
    const std::uint32_t element = nodes_[wide.node[lane]].element;
    wide.child[lane] = element != kInner ? element | kLeaf : widen(wide.node[lane]);
  }
  wide_[index] = wide;
  return index;
}

void Bvh::refit_wide() {
  for (WideNode& wide : wide_) {
    for (int lane = 0; (wide.lanes >> lane) != 0; ++lane) {
      const Box& box = boxes_[wide.node[lane]];
      for (int k = 0; k < 3; ++k) {
        wide.lower[k][lane] = box.lower[k];
        wide.upper[k][lane] = box.upper[k];
      }
    }
  }
}

void Bvh::refit(std::span<const Box> boxes) {
  if (boxes.size() != leaf_of_.size()) throw_internal("Bvh::refit: another number of elements");
  // Children come after their parents, so that one backward pass suffices.
  for (std::size_t node = nodes_.size(); node-- > 0;) {
    if (nodes_[node].element != kInner) {
      boxes_[node] = boxes[nodes_[node].element];
    } else {
      Box box = boxes_[node + 1];
      box.extend(boxes_[nodes_[node].right]);
      boxes_[node] = box;
    }
  }
  refit_wide();
}

std::vector<Bvh::Pair> Bvh::self_pair_parts(int levels) const {
  if (empty()) return {};
  std::vector<Pair> parts{{0, 0}};
  for (int level = 0; level < levels; ++level) {
    std::vector<Pair> next;
    for (const auto& [p, q] : parts) {
      const bool leaf_p = nodes_[p].element != kInner, leaf_q = nodes_[q].element != kInner;
      if (p == q && !leaf_p) {
        next.push_back({p + 1, p + 1});
        next.push_back({p + 1, nodes_[p].right});
        next.push_back({nodes_[p].right, nodes_[p].right});
      } else if (p != q && !leaf_p && !leaf_q) {
        for (const std::uint32_t a : {p + 1, nodes_[p].right}) {
          for (const std::uint32_t b : {q + 1, nodes_[q].right}) next.push_back({a, b});
        }
      } else if (p != q) {
        next.push_back({p, q});
      }
    }
    parts = std::move(next);
  }
  return parts;
}

}  // namespace pleat
