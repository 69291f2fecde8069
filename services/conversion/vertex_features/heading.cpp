#include "services/conversion/vertex_features/heading.hpp"

#include <cmath>
#include <numbers>

namespace pleat::conversion {

Eigen::Vector3f centroid(const Positions& positions) {
  if (positions.rows() == 0) return Eigen::Vector3f::Zero();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (Eigen::Index v = 0; v < positions.rows(); ++v) sum += positions.row(v).cast<double>().transpose();
  return (sum / static_cast<double>(positions.rows())).cast<float>();
}

float heading(const Positions& rest_positions, const Positions& positions, float previous) {
  const Eigen::RowVector3f a0 = centroid(rest_positions), b0 = centroid(positions);
  double sine = 0, cosine = 0, size = 0;
  for (Eigen::Index v = 0; v < rest_positions.rows(); ++v) {
    const Eigen::RowVector3d a = (rest_positions.row(v) - a0).cast<double>();
    const Eigen::RowVector3d b = (positions.row(v) - b0).cast<double>();
    sine += a.z() * b.x() - a.x() * b.z();
    cosine += a.x() * b.x() + a.z() * b.z();
    size += a.x() * a.x() + a.z() * a.z();
  }
  if (!(std::hypot(sine, cosine) >= 0.1 * size) || size == 0) return previous;
  constexpr double kTurn = 2 * std::numbers::pi;
  const double angle = std::atan2(sine, cosine);
  return static_cast<float>(angle + kTurn * std::nearbyint((static_cast<double>(previous) - angle) / kTurn));
}

}  // namespace pleat::conversion
