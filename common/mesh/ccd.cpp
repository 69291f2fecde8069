#include "common/mesh/ccd.hpp"

#include <algorithm>
#include <cmath>

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;
using Quad = std::array<Vec3, 4>;

template <typename Distance>
std::optional<Collision> additive_ccd(Quad x, const Quad& end, const CcdOptions& options, int first_count,
                                      const Distance& closest) {
  ClosestPoints points = closest(x);
  Quad motion;
  Vec3 mean = Vec3::Zero();
  for (std::size_t i = 0; i < 4; ++i) {
    motion[i] = end[i] - x[i];
    mean += 0.25 * motion[i];
  }
  double first = 0, second = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    motion[i] -= mean;
    double& side = i < static_cast<std::size_t>(first_count) ? first : second;
    side = std::max(side, motion[i].squaredNorm());
  }
  const double bound = std::sqrt(first) + std::sqrt(second);
  double distance = std::sqrt(points.squared_distance);
  double clearance = distance - options.minimum_distance;
  if (clearance <= 0) {
    // Too close from the start: it may part, but not come closer.
    if (bound == 0) return std::nullopt;
    return Collision{0, points};
  }
  // The gap counts at the end of the motion too: rounding there must neither hide a touch nor, later, make one.
  const double gap = std::min(options.gap, 0.1 * clearance);
  if (clearance - gap > bound) return std::nullopt;

  double time = 0;
  for (int i = 0; i < options.max_iterations; ++i) {
    if (time + (clearance - gap) / bound > 1) return std::nullopt;
    const double step = std::min(0.9 * clearance / bound, 1 - time);
    time += step;
    for (std::size_t k = 0; k < 4; ++k) x[k] += step * motion[k];
    points = closest(x);
    distance = std::sqrt(points.squared_distance);
    clearance = distance - options.minimum_distance;
    if (clearance <= gap) return Collision{std::min(time, 1.0), points};
  }
  return Collision{time, points};
}

}  // namespace

std::optional<Collision> vertex_face_ccd(const Quad& start, const Quad& end, const CcdOptions& options) {
  return additive_ccd(start, end, options, 1,
                      [](const Quad& x) { return closest_vertex_face(x[0], x[1], x[2], x[3]); });
}

std::optional<Collision> edge_edge_ccd(const Quad& start, const Quad& end, const CcdOptions& options) {
  return additive_ccd(start, end, options, 2, [](const Quad& x) { return closest_edge_edge(x[0], x[1], x[2], x[3]); });
}

double motion_bound(const Quad& start, const Quad& end, int first_count) {
  Quad motion;
  Vec3 mean = Vec3::Zero();
  for (std::size_t i = 0; i < 4; ++i) {
    motion[i] = end[i] - start[i];
    mean += 0.25 * motion[i];
  }
  double first = 0, second = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    double& side = i < static_cast<std::size_t>(first_count) ? first : second;
    side = std::max(side, (motion[i] - mean).squaredNorm());
  }
  return std::sqrt(first) + std::sqrt(second);
}

}  // namespace pleat
