// Constraints eight at a time: vectors in lanes, and packs of constraints without common vertices.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/simd.hpp"

namespace pleat::fold {

inline constexpr std::size_t kLanes = 8;
using Lanes = std::array<std::uint32_t, kLanes>;  ///< a vertex per lane

inline float dot(Float4 a, Float4 b) {
  const Float4 product = a * b;
  return product[0] + product[1] + product[2];
}
inline Float4 cross(Float4 a, Float4 b) {
  return Float4{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0};
}

struct Vector8 {
  Float8 x, y, z;
};
inline Float8 dot(const Vector8& a, const Vector8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

inline Vector8 from_rows(const Float4 (&rows)[kLanes]) {
  Float8 columns[4];
  transpose(rows, columns);
  return {columns[0], columns[1], columns[2]};
}

/// Distributes elements (with an array of vertices v) over packs of eight that share no vertex, close to their order: a
/// constraint solver may treat the lanes of a pack at once. Returns the elements of every pack, at most eight.
template <typename Element>
std::vector<std::vector<std::uint32_t>> independent_packs(std::span<const Element> elements) {
  constexpr std::size_t kOpen = 64;  // packs that still wait for elements
  std::vector<std::vector<std::uint32_t>> packs;
  std::vector<std::size_t> open;
  std::vector<std::vector<std::uint32_t>> vertices;  // of the pack
  for (std::uint32_t e = 0; e < elements.size(); ++e) {
    const auto disjoint = [&](std::size_t pack) {
      for (const std::uint32_t v : elements[e].v) {
        for (const std::uint32_t w : vertices[pack]) {
          if (v == w) return false;
        }
      }
      return true;
    };
    std::size_t slot = 0;
    while (slot < open.size() && !disjoint(open[slot])) ++slot;
    if (slot == open.size()) {
      if (open.size() == kOpen) {
        open.erase(open.begin());
        --slot;
      }
      open.push_back(packs.size());
      packs.emplace_back();
      vertices.emplace_back();
    }
    const std::size_t pack = open[slot];
    packs[pack].push_back(e);
    vertices[pack].insert(vertices[pack].end(), elements[e].v.begin(), elements[e].v.end());
    if (packs[pack].size() == kLanes) open.erase(open.begin() + static_cast<std::ptrdiff_t>(slot));
  }
  return packs;
}

}  // namespace pleat::fold
