#include "common/mesh/triangulate.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace pleat {
namespace {

using Point = Eigen::Vector2d;

/// Twice the signed area.
double area(const Point& a, const Point& b, const Point& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
}

/// The polygon in the plane of its vector area, which points at the viewer; nothing if it has none.
std::vector<Point> project(std::span<const Eigen::Vector3f> polygon) {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double size = 0;
  const Eigen::Vector3d origin = polygon[0].cast<double>();
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector3d a = polygon[i].cast<double>() - origin;
    const Eigen::Vector3d b = polygon[(i + 1) % polygon.size()].cast<double>() - origin;
    normal += a.cross(b);
    size = std::max(size, a.squaredNorm());
  }
  constexpr double kFlat = 1e-9;  // of the squared extent
  if (!(normal.norm() > kFlat * size)) return {};
  normal.normalize();
  const Eigen::Vector3d x = normal.unitOrthogonal(), y = normal.cross(x);
  std::vector<Point> points;
  for (const Eigen::Vector3f& corner : polygon) {
    const Eigen::Vector3d p = corner.cast<double>() - origin;
    points.emplace_back(p.dot(x), p.dot(y));
  }
  return points;
}

/// Area over the squared longest edge: 0 for a sliver, 0.87 for an equilateral triangle.
double quality(const Point& a, const Point& b, const Point& c) {
  const double longest = std::max({(b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm()});
  return longest > 0 ? area(a, b, c) / longest : 0;
}

class EarCutter {
 public:
  explicit EarCutter(const std::vector<Point>& points) : points_(points) {
    for (std::uint32_t i = 0; i < points.size(); ++i) left_.push_back(i);
  }

  std::optional<std::vector<std::array<std::uint32_t, 3>>> cut() {
    std::vector<std::array<std::uint32_t, 3>> triangles;
    while (left_.size() > 3) {
      const std::size_t ear = best_ear();
      if (ear == left_.size()) return std::nullopt;
      triangles.push_back({before(ear), left_[ear], after(ear)});
      left_.erase(left_.begin() + static_cast<std::ptrdiff_t>(ear));
    }
    if (area(points_[left_[0]], points_[left_[1]], points_[left_[2]]) < 0) return std::nullopt;
    triangles.push_back({left_[0], left_[1], left_[2]});
    return triangles;
  }

 private:
  std::uint32_t before(std::size_t i) const { return left_[(i + left_.size() - 1) % left_.size()]; }
  std::uint32_t after(std::size_t i) const { return left_[(i + 1) % left_.size()]; }

  std::size_t best_ear() const {
    std::size_t best = left_.size();
    double most = -1;
    for (std::size_t i = 0; i < left_.size(); ++i) {
      const Point &a = points_[before(i)], &b = points_[left_[i]], &c = points_[after(i)];
      const double value = quality(a, b, c);
      if (value > most && value >= 0 && is_free(i)) best = i, most = value;
    }
    return best;
  }

  /// Whether no other corner lies in the triangle of corner i, its far side included.
  bool is_free(std::size_t i) const {
    const Point &a = points_[before(i)], &b = points_[left_[i]], &c = points_[after(i)];
    for (const std::uint32_t other : left_) {
      if (other == before(i) || other == left_[i] || other == after(i)) continue;
      const Point& p = points_[other];
      if (p == a || p == b || p == c) continue;  // corners of a bridge to a hole come twice
      if (area(a, b, p) >= 0 && area(b, c, p) >= 0 && area(c, a, p) >= 0) return false;
    }
    return true;
  }

  const std::vector<Point>& points_;
  std::vector<std::uint32_t> left_;
};

std::vector<std::array<std::uint32_t, 3>> fan(std::size_t corners) {
  std::vector<std::array<std::uint32_t, 3>> triangles;
  for (std::uint32_t i = 2; i < corners; ++i) triangles.push_back({0, i - 1, i});
  return triangles;
}

/// Whether the fan from corner 0 turns one way all along, and less than once round.
bool is_star(const std::vector<Point>& points) {
  double turned = 0;
  for (std::size_t i = 2; i < points.size(); ++i) {
    const Point a = points[i - 1] - points[0], b = points[i] - points[0];
    const double cross = a.x() * b.y() - a.y() * b.x();
    if (!(cross > 1e-12 * (a.squaredNorm() + b.squaredNorm()))) return false;
    turned += std::atan2(cross, a.dot(b));
  }
  return turned < 2 * M_PI;
}

}  // namespace

std::optional<std::vector<std::array<std::uint32_t, 3>>> triangulate(std::span<const Eigen::Vector3f> polygon) {
  if (polygon.size() == 3) return fan(3);
  const std::vector<Point> points = project(polygon);
  if (points.empty() || is_star(points)) return fan(polygon.size());
  return EarCutter(points).cut();
}

}  // namespace pleat
