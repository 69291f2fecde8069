#include "services/evaluation/surface_distance.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"

namespace pleat::evaluation {
namespace {

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

SurfaceDistance::SurfaceDistance(const Faces& faces, const Positions& positions) : faces_(faces) {
  if (faces.rows() == 0) throw_invalid_argument("a distance needs a surface with faces");
  points_.reserve(static_cast<std::size_t>(positions.rows()));
  for (Eigen::Index i = 0; i < positions.rows(); ++i) points_.emplace_back(positions.row(i).transpose().cast<double>());
  std::vector<Box> boxes(static_cast<std::size_t>(faces.rows()));
  for (std::size_t f = 0; f < boxes.size(); ++f) {
    for (int corner = 0; corner < 3; ++corner) {
      boxes[f].extend(points_[faces(static_cast<Eigen::Index>(f), corner)]);
    }
  }
  hierarchy_ = Bvh(boxes);
}

double SurfaceDistance::squared_distance(const Eigen::Vector3d& p, double squared_bound) const {
  double best = squared_bound;
  hierarchy_.nearest(p, best, [&](std::uint32_t face) {
    const auto row = faces_.row(face);
    best = std::min(best, closest_vertex_face(p, points_[row[0]], points_[row[1]], points_[row[2]]).squared_distance);
    return best;
  });
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
