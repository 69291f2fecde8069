#include "services/dataset/planar_mesh.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::dataset {
namespace {

using Eigen::Vector2d;
using Triangle = std::array<std::uint32_t, 3>;

constexpr int kAttempts = 12;
constexpr double kClearance = 0.6;      // edges: of vertices inside from the outline
constexpr double kShake = 1e-4;         // edges: so that no four points of the search lie on a circle
constexpr double kShear = 2e-3;         // makes all diagonals of a grid alike
constexpr double kSliver = 0.02;        // edges^2: area below which a triangle is one, along a straight side
constexpr double kSmallestAngle = 8;    // degrees
constexpr double kDarts = 60;           // tries per vertex
constexpr double kDartDistance = 0.78;  // edges, between vertices by chance
constexpr double kFarAway = 1e3;        // extents: corners of the triangle around everything
constexpr double kSmoothing = 0.5;      // share of the way to the neighbours' mean, of vertices by chance

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }
double area(const Vector2d& a, const Vector2d& b, const Vector2d& c) { return 0.5 * cross(b - a, c - a); }

double area_of(const Points& polygon) {
  double sum = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i) sum += cross(polygon[i], polygon[(i + 1) % polygon.size()]);
  return 0.5 * sum;
}

bool is_inside(const Points& polygon, const Vector2d& p) {
  bool inside = false;
  for (std::size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Vector2d &a = polygon[i], &b = polygon[j];
    if ((a.y() > p.y()) != (b.y() > p.y()) && p.x() < (b.x() - a.x()) * (p.y() - a.y()) / (b.y() - a.y()) + a.x()) {
      inside = !inside;
    }
  }
  return inside;
}

double distance_to(const Points& polygon, const Vector2d& p) {
  double least = 1e300;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector2d &a = polygon[i], side = polygon[(i + 1) % polygon.size()] - a;
    const double t = std::clamp((p - a).dot(side) / side.squaredNorm(), 0.0, 1.0);
    least = std::min(least, (p - a - t * side).norm());
  }
  return least;
}

bool in_circle(const Vector2d& a, const Vector2d& b, const Vector2d& c, const Vector2d& p) {
  Eigen::Matrix3d m;
  m << a.x() - p.x(), a.y() - p.y(), (a - p).squaredNorm(), b.x() - p.x(), b.y() - p.y(), (b - p).squaredNorm(),
      c.x() - p.x(), c.y() - p.y(), (c - p).squaredNorm();
  return m.determinant() > 0;
}

/// Delaunay's triangulation (Bowyer 1981, Watson 1981) of the points' convex hull, perhaps without slivers at its rim.
std::vector<Triangle> delaunay(Points points) {
  Vector2d low = points.front(), high = low;
  for (const Vector2d& p : points) low = low.cwiseMin(p), high = high.cwiseMax(p);
  const Vector2d middle = 0.5 * (low + high);
  const double far = kFarAway * (high - low).maxCoeff();
  const auto count = static_cast<std::uint32_t>(points.size());
  points.push_back(middle + Vector2d(-far, -far));
  points.push_back(middle + Vector2d(far, -far));
  points.push_back(middle + Vector2d(0, far));
  std::vector<Triangle> triangles{{count, count + 1, count + 2}};
  for (std::uint32_t p = 0; p < count; ++p) {
    std::vector<Triangle> kept;
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> rim;  // edges of the hole
    for (const Triangle& t : triangles) {
      if (!in_circle(points[t[0]], points[t[1]], points[t[2]], points[p])) {
        kept.push_back(t);
        continue;
      }
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t a = t[k], b = t[(k + 1) % 3];
        if (const auto other = rim.find({b, a}); other != rim.end()) {
          rim.erase(other);
        } else {
          rim[{a, b}] = 1;
        }
      }
    }
    for (const auto& [edge, ignored] : rim) kept.push_back({edge.first, edge.second, p});
    triangles = std::move(kept);
  }
  std::erase_if(triangles,
                [&](const Triangle& t) { return std::any_of(t.begin(), t.end(), [&](auto v) { return v >= count; }); });
  return triangles;
}

/// Places inside, at least kClearance from the outline.
Points inner_points(const Points& outline, double edge, Pattern pattern, Random& random) {
  Vector2d low = outline.front(), high = low;
  for (const Vector2d& p : outline) low = low.cwiseMin(p), high = high.cwiseMax(p);
  Points points;
  const auto fits = [&](const Vector2d& p) {
    return is_inside(outline, p) && distance_to(outline, p) > kClearance * edge;
  };
  if (pattern == Pattern::kIrregular) {
    const double wanted = area_of(outline) / (edge * edge * 0.866);
    // A grid of cells no larger than the distance would be quicker; a garment has a thousand vertices at most.
    for (int dart = 0; dart < static_cast<int>(kDarts * wanted); ++dart) {
      const Vector2d p(random.uniform(low.x(), high.x()), random.uniform(low.y(), high.y()));
      const double clear = kDartDistance * edge;
      if (!fits(p) || std::any_of(points.begin(), points.end(),
                                  [&](const Vector2d& q) { return (p - q).squaredNorm() < clear * clear; })) {
        continue;
      }
      points.push_back(p);
    }
    return points;
  }
  const bool hexagonal = pattern == Pattern::kHexagonal;
  const Vector2d size = high - low;
  const double rows = std::max(1.0, std::round(size.y() / (hexagonal ? 0.866 * edge : edge)));
  const double columns = std::max(1.0, std::round(size.x() / edge));
  const Vector2d step(size.x() / columns, size.y() / rows);
  for (int j = 0; j <= static_cast<int>(rows); ++j) {
    const double shift = hexagonal && j % 2 != 0 ? 0.5 : 0.0;
    for (int i = 0; i <= static_cast<int>(columns); ++i) {
      const Vector2d p = low + Vector2d((i + shift) * step.x(), j * step.y());
      if (fits(p)) points.push_back(p);
    }
  }
  return points;
}

std::vector<Triangle> triangles_within(const Points& outline, const Points& points, double edge, Pattern pattern,
                                       Random& random) {
  Points searched = points;
  for (Vector2d& p : searched) {
    if (pattern == Pattern::kSquare) p.x() += kShear * p.y();
    // Along a sheared side diagonals are decided; the shake is for the outline's straight sides alone.
    const double shake = (pattern == Pattern::kDiagonals ? 10 : 1) * kShake * edge;
    p += Vector2d(random.uniform(-shake, shake), random.uniform(-shake, shake));
  }
  std::vector<Triangle> triangles = delaunay(searched);
  std::erase_if(triangles, [&](const Triangle& t) {
    const Vector2d &a = points[t[0]], &b = points[t[1]], &c = points[t[2]];
    return area(a, b, c) < kSliver * edge * edge || !is_inside(outline, (a + b + c) / 3);
  });
  return triangles;
}

void smooth(std::size_t fixed, const std::vector<Triangle>& triangles, Points& points) {
  Points sums(points.size(), Vector2d::Zero());
  std::vector<double> counts(points.size(), 0);
  for (const Triangle& t : triangles) {
    for (std::size_t k = 0; k < 3; ++k) {
      sums[t[k]] += points[t[(k + 1) % 3]] + points[t[(k + 2) % 3]];
      counts[t[k]] += 2;
    }
  }
  for (std::size_t v = fixed; v < points.size(); ++v) {
    if (counts[v] > 0) points[v] += kSmoothing * (sums[v] / counts[v] - points[v]);
  }
}

double smallest_angle(const Points& points, const std::vector<Triangle>& triangles) {
  double least = 180;
  for (const Triangle& t : triangles) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Vector2d a = points[t[(k + 1) % 3]] - points[t[k]], b = points[t[(k + 2) % 3]] - points[t[k]];
      least = std::min(least, std::atan2(cross(a, b), a.dot(b)) * 180 / std::numbers::pi);
    }
  }
  return least;
}

/// Whether the triangles are the polygon: as large, with its sides as their border, and every point in use.
bool covers(const Points& outline, const Points& points, const std::vector<Triangle>& triangles) {
  double sum = 0;
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  std::vector<char> used(points.size(), 0);
  for (const Triangle& t : triangles) {
    sum += area(points[t[0]], points[t[1]], points[t[2]]);
    for (std::size_t k = 0; k < 3; ++k) {
      used[t[k]] = 1;
      if (++edges[{t[k], t[(k + 1) % 3]}] > 1) return false;
    }
  }
  if (std::abs(sum - area_of(outline)) > 1e-9 * sum) return false;
  std::size_t border = 0;
  for (const auto& [edge, count] : edges) border += edges.count({edge.second, edge.first}) == 0 ? 1 : 0;
  for (std::uint32_t i = 0; i < outline.size(); ++i) {
    if (edges.count({i, (i + 1) % static_cast<std::uint32_t>(outline.size())}) == 0) return false;
  }
  return border == outline.size() && std::all_of(used.begin(), used.end(), [](char u) { return u != 0; });
}

}  // namespace

Points cut_sides(const std::vector<Points>& sides, double edge) {
  Points outline;
  for (const Points& side : sides) {
    double length = 0;
    for (std::size_t i = 1; i < side.size(); ++i) length += (side[i] - side[i - 1]).norm();
    const int pieces = std::max(1, static_cast<int>(std::lround(length / edge)));
    std::size_t at = 1;
    double before = 0;  // length up to side[at - 1]
    for (int k = 0; k < pieces; ++k) {
      const double wanted = length * k / pieces;
      while (at + 1 < side.size() && before + (side[at] - side[at - 1]).norm() < wanted) {
        before += (side[at] - side[at - 1]).norm();
        ++at;
      }
      const Vector2d along = side[at] - side[at - 1];
      outline.push_back(side[at - 1] + std::clamp((wanted - before) / along.norm(), 0.0, 1.0) * along);
    }
  }
  return outline;
}

PlanarMesh mesh_outline(const Points& outline, double edge, Pattern pattern, Random& random) {
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    // What a pattern can't cover well (acute corners) chance may.
    const Pattern tried = attempt < kAttempts / 2 ? pattern : Pattern::kIrregular;
    PlanarMesh mesh;
    mesh.points = outline;
    const Points inner = inner_points(outline, edge, tried, random);
    mesh.points.insert(mesh.points.end(), inner.begin(), inner.end());
    mesh.faces = triangles_within(outline, mesh.points, edge, tried, random);
    if (tried == Pattern::kIrregular) {
      smooth(outline.size(), mesh.faces, mesh.points);
      mesh.faces = triangles_within(outline, mesh.points, edge, tried, random);
    }
    if (covers(outline, mesh.points, mesh.faces) && smallest_angle(mesh.points, mesh.faces) > kSmallestAngle)
      return mesh;
  }
  throw_internal("data set: an outline can't be cut into triangles");
}

}  // namespace pleat::dataset
