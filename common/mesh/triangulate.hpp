// Polygons as triangles.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// The n - 2 triangles that cover a polygon of n >= 3 corners in space, as corner numbers, with its orientation: of its
/// projection along the vector area (Newell's normal) they cover the inside and nothing else. A polygon that is convex
/// seen from corner 0, and one without area, is cut as the fan (0, i, i + 1); others lose their ears, the best shaped
/// first. Nothing if it crosses itself. O(n) for fans, else O(n^3).
std::optional<std::vector<std::array<std::uint32_t, 3>>> triangulate(std::span<const Eigen::Vector3f> polygon);

}  // namespace pleat
