#include "services/evaluation/surface_distance.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/base/error.hpp"

namespace pleat::evaluation {
namespace {

constexpr std::uint32_t kLeafFaces = 4;

double one_sided(const SurfaceDistance& surface, const std::vector<Eigen::Vector3d>& points,
                 const std::vector<double>& bounds, const std::vector<std::uint32_t>& order, double largest) {
  for (const std::uint32_t i : order) {
    // The twin vertex lies on the other surface, so that its distance bounds this one; the order is descending.
    if (bounds[i] <= largest) break;
    largest = std::max(largest, surface.squared_distance(points[i], bounds[i]));
  }
  return largest;
}

}  // namespace

// Regions of the closest point as in Ericson, Real-Time Collision Detection, section 5.1.5.
double squared_point_triangle_distance(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                       const Eigen::Vector3d& c) {
  const auto to_segment = [&p](const Eigen::Vector3d& s, const Eigen::Vector3d& e) {
    const Eigen::Vector3d d = e - s;
    const double length2 = d.squaredNorm();
    const double t = length2 > 0 ? std::clamp((p - s).dot(d) / length2, 0.0, 1.0) : 0.0;
    return (p - s - t * d).squaredNorm();
  };
  const Eigen::Vector3d ab = b - a, ac = c - a;
  const Eigen::Vector3d normal = ab.cross(ac);
  const double area2 = normal.squaredNorm();
  if (area2 > 0) {
    const Eigen::Vector3d ap = p - a;
    const double v = normal.dot(ap.cross(ac)) / area2;
    const double w = normal.dot(ab.cross(ap)) / area2;
    if (v >= 0 && w >= 0 && v + w <= 1) {
      const double height = normal.dot(ap);
      return height * height / area2;
    }
  }
  return std::min({to_segment(a, b), to_segment(b, c), to_segment(c, a)});
}

SurfaceDistance::SurfaceDistance(const Faces& faces, const Positions& positions) : faces_(faces) {
  if (faces.rows() == 0) throw_invalid_argument("a distance needs a surface with faces");
  points_.reserve(static_cast<std::size_t>(positions.rows()));
  for (Eigen::Index i = 0; i < positions.rows(); ++i) points_.emplace_back(positions.row(i).transpose().cast<double>());
  const auto count = static_cast<std::size_t>(faces.rows());
  std::vector<Eigen::Vector3d> centroids(count);
  for (std::size_t f = 0; f < count; ++f) {
    const auto row = faces.row(static_cast<Eigen::Index>(f));
    centroids[f] = (points_[row[0]] + points_[row[1]] + points_[row[2]]) / 3.0;
  }
  order_.resize(count);
  std::iota(order_.begin(), order_.end(), 0u);
  nodes_.reserve(2 * count);
  build(0, static_cast<std::uint32_t>(count), centroids);
}

std::uint32_t SurfaceDistance::build(std::uint32_t begin, std::uint32_t end,
                                     const std::vector<Eigen::Vector3d>& centroids) {
  const auto index = static_cast<std::uint32_t>(nodes_.size());
  nodes_.emplace_back();
  Eigen::AlignedBox3d box, centroid_box;
  for (std::uint32_t k = begin; k < end; ++k) {
    const auto row = faces_.row(order_[k]);
    for (int corner = 0; corner < 3; ++corner) box.extend(points_[row[corner]]);
    centroid_box.extend(centroids[order_[k]]);
  }
  nodes_[index].box = box;
  if (end - begin <= kLeafFaces) {
    nodes_[index].first = begin;
    nodes_[index].count = end - begin;
    return index;
  }
  Eigen::Index axis = 0;
  centroid_box.sizes().maxCoeff(&axis);
  const std::uint32_t middle = begin + (end - begin) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                   [&](std::uint32_t x, std::uint32_t y) { return centroids[x][axis] < centroids[y][axis]; });
  build(begin, middle, centroids);
  nodes_[index].first = build(middle, end, centroids);
  return index;
}

double SurfaceDistance::squared_distance(const Eigen::Vector3d& p, double squared_bound) const {
  // Median splits keep the depth below log2(F) + 1, far less than the stack.
  std::array<std::uint32_t, 128> stack;
  std::size_t top = 0;
  stack[top++] = 0;
  double best = squared_bound;
  while (top > 0) {
    const std::uint32_t at = stack[--top];
    const Node& node = nodes_[at];
    if (node.box.squaredExteriorDistance(p) >= best) continue;
    if (node.count > 0) {
      for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
        const auto row = faces_.row(order_[k]);
        best = std::min(best, squared_point_triangle_distance(p, points_[row[0]], points_[row[1]], points_[row[2]]));
      }
      continue;
    }
    std::uint32_t near = at + 1, far = node.first;
    if (nodes_[far].box.squaredExteriorDistance(p) < nodes_[near].box.squaredExteriorDistance(p)) std::swap(near, far);
    stack[top++] = far;
    stack[top++] = near;
  }
  return best;
}

double hausdorff_distance(const Faces& faces, const Positions& a, const Positions& b) {
  if (a.rows() != b.rows()) throw_invalid_argument("a Hausdorff distance needs two meshes of the same topology");
  const auto count = static_cast<std::size_t>(a.rows());
  std::vector<Eigen::Vector3d> points_a(count), points_b(count);
  std::vector<double> bounds(count);
  for (std::size_t i = 0; i < count; ++i) {
    points_a[i] = a.row(static_cast<Eigen::Index>(i)).transpose().cast<double>();
    points_b[i] = b.row(static_cast<Eigen::Index>(i)).transpose().cast<double>();
    bounds[i] = (points_a[i] - points_b[i]).squaredNorm();
  }
  // A vertex without a face is not part of the surface, neither as a source nor as a bound.
  std::vector<std::uint8_t> used(count, 0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f)
    for (int corner = 0; corner < 3; ++corner) used[faces(f, corner)] = 1;
  std::vector<std::uint32_t> order;
  for (std::uint32_t i = 0; i < count; ++i)
    if (used[i] != 0) order.push_back(i);
  std::sort(order.begin(), order.end(), [&](std::uint32_t x, std::uint32_t y) { return bounds[x] > bounds[y]; });
  double largest = one_sided(SurfaceDistance(faces, b), points_a, bounds, order, 0.0);
  largest = one_sided(SurfaceDistance(faces, a), points_b, bounds, order, largest);
  return std::sqrt(largest);
}

}  // namespace pleat::evaluation
