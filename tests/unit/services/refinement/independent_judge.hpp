// A second opinion on cleanness that shares no code path with the library's trees and exclusions: a sweep over all
// pairs, decided by CGAL with exact predicates, and obstacles by winding numbers and sampled distances.
#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "common/mesh/triangle_intersection.hpp"

#if PLEAT_HAVE_CGAL
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/intersections.h>
#endif

namespace pleat::test {

#if PLEAT_HAVE_CGAL
using Cgal = CGAL::Exact_predicates_inexact_constructions_kernel;

inline Cgal::Point_3 cgal_point(const Positions& x, std::uint32_t v) {
  return {static_cast<double>(x(v, 0)), static_cast<double>(x(v, 1)), static_cast<double>(x(v, 2))};
}

/// A face as CGAL has it: a triangle, or the segment or point that a face without area is.
struct CgalFace {
  std::vector<Cgal::Point_3> corners;  ///< 3, 2 or 1

  static CgalFace of(std::vector<Cgal::Point_3> p) {
    if (p.size() == 3 && !CGAL::collinear(p[0], p[1], p[2])) return {p};
    const auto [low, high] = std::minmax_element(
        p.begin(), p.end(), [](const auto& a, const auto& b) { return CGAL::lexicographically_xyz_smaller(a, b); });
    if (*low == *high) return {{*low}};
    return {{*low, *high}};
  }
  Cgal::Triangle_3 triangle() const { return {corners[0], corners[1], corners[2]}; }
  Cgal::Segment_3 segment() const { return {corners[0], corners[1]}; }
};

inline bool meet(const CgalFace& a, const CgalFace& b) {
  if (a.corners.size() < b.corners.size()) return meet(b, a);
  if (a.corners.size() == 3) {
    if (b.corners.size() == 3) return CGAL::do_intersect(a.triangle(), b.triangle());
    if (b.corners.size() == 2) return CGAL::do_intersect(a.triangle(), b.segment());
    return a.triangle().has_on(b.corners[0]);
  }
  if (a.corners.size() == 1) return a.corners[0] == b.corners[0];
  if (b.corners.size() == 1) return a.segment().has_on(b.corners[0]);
  return CGAL::do_intersect(a.segment(), b.segment());
}

/// As documented in judge.hpp and triangle_intersection.hpp.
inline bool intersect(const Positions& x, const Faces& faces, std::uint32_t f, std::uint32_t g) {
  std::vector<std::uint32_t> common, f_own, g_own;
  for (int k = 0; k < 3; ++k) {
    const auto row = faces.row(g);
    const std::uint32_t v = faces(f, k), w = faces(g, k);
    ((row.array() == v).any() ? common : f_own).push_back(v);
    if (!(faces.row(f).array() == w).any()) g_own.push_back(w);
  }
  const auto face = [&](std::uint32_t i) {
    return CgalFace::of({cgal_point(x, faces(i, 0)), cgal_point(x, faces(i, 1)), cgal_point(x, faces(i, 2))});
  };
  const auto edge = [&](const std::vector<std::uint32_t>& ends) {
    return CgalFace::of({cgal_point(x, ends[0]), cgal_point(x, ends[1])});
  };
  if (common.empty()) return meet(face(f), face(g));
  if (common.size() == 1) return meet(edge(f_own), face(g)) || meet(edge(g_own), face(f));
  if (common.size() == 3) return true;
  const bool f_flat = face(f).corners.size() < 3, g_flat = face(g).corners.size() < 3;
  if (f_flat || g_flat) return f_flat && g_flat;
  const Cgal::Point_3 u = cgal_point(x, common[0]), v = cgal_point(x, common[1]);
  const Cgal::Point_3 p = cgal_point(x, f_own[0]), q = cgal_point(x, g_own[0]);
  return CGAL::coplanar(u, v, p, q) && CGAL::coplanar_orientation(u, v, p, q) == CGAL::POSITIVE;
}
#else
inline bool intersect(const Positions& x, const Faces& faces, std::uint32_t f, std::uint32_t g) {
  return faces_intersect(x, faces, f, g);
}
#endif

/// All pairs, each asked for.
inline std::vector<std::array<std::uint32_t, 2>> all_self_intersections(const Positions& x, const Faces& faces) {
  std::vector<std::array<std::uint32_t, 2>> pairs;
  for (std::uint32_t f = 0; f < static_cast<std::uint32_t>(faces.rows()); ++f) {
    for (std::uint32_t g = f + 1; g < static_cast<std::uint32_t>(faces.rows()); ++g) {
      if (intersect(x, faces, f, g)) pairs.push_back({f, g});
    }
  }
  return pairs;
}

/// All pairs by a sweep along x.
inline std::vector<std::array<std::uint32_t, 2>> sweep_self_intersections(const Positions& x, const Faces& faces) {
  struct Bounds {
    Eigen::Array3f low, high;
  };
  std::vector<Bounds> bounds(static_cast<std::size_t>(faces.rows()));
  for (std::size_t f = 0; f < bounds.size(); ++f) {
    const auto row = static_cast<Eigen::Index>(f);
    bounds[f].low = x.row(faces(row, 0)).cwiseMin(x.row(faces(row, 1))).cwiseMin(x.row(faces(row, 2))).array();
    bounds[f].high = x.row(faces(row, 0)).cwiseMax(x.row(faces(row, 1))).cwiseMax(x.row(faces(row, 2))).array();
  }
  std::vector<std::uint32_t> order(bounds.size());
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return bounds[a].low[0] < bounds[b].low[0]; });
  std::vector<std::array<std::uint32_t, 2>> pairs;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const Bounds& a = bounds[order[i]];
    for (std::size_t j = i + 1; j < order.size() && bounds[order[j]].low[0] <= a.high[0]; ++j) {
      const Bounds& b = bounds[order[j]];
      if ((a.low > b.high).any() || (b.low > a.high).any() || !intersect(x, faces, order[i], order[j])) continue;
      pairs.push_back({std::min(order[i], order[j]), std::max(order[i], order[j])});
    }
  }
  std::sort(pairs.begin(), pairs.end());
  return pairs;
}

/// How deep a dense lattice of points of the cloth is inside a sphere, at most; negative if outside.
inline double sphere_depth(const Positions& x, const Faces& faces, const Eigen::Vector3f& center, float radius) {
  constexpr int kSteps = 8;
  double depth = -1e9;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i <= kSteps; ++i) {
      for (int j = 0; i + j <= kSteps; ++j) {
        const double a = static_cast<double>(i) / kSteps, b = static_cast<double>(j) / kSteps;
        const Eigen::Vector3d p = a * x.row(faces(f, 0)).cast<double>() + b * x.row(faces(f, 1)).cast<double>() +
                                  (1 - a - b) * x.row(faces(f, 2)).cast<double>();
        depth = std::max(depth, static_cast<double>(radius) - (p - center.cast<double>()).norm());
      }
    }
  }
  return depth;
}

/// The generalised winding number of a closed mesh around p: 1 inside, 0 outside (van Oosterom and Strackee 1983).
inline double winding_number(const Positions& x, const Faces& faces, const Eigen::Vector3d& p) {
  double sum = 0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    Eigen::Matrix3d m;
    for (int k = 0; k < 3; ++k) m.col(k) = x.row(faces(f, k)).cast<double>().transpose() - p;
    const double la = m.col(0).norm(), lb = m.col(1).norm(), lc = m.col(2).norm();
    sum += 2 * std::atan2(m.determinant(), la * lb * lc + m.col(0).dot(m.col(1)) * lc + m.col(1).dot(m.col(2)) * la +
                                               m.col(2).dot(m.col(0)) * lb);
  }
  return sum / (4 * std::numbers::pi);
}

}  // namespace pleat::test
