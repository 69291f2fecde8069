#include "services/simulation/strain_limits.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace pleat::simulation {
namespace {

constexpr int kSweeps = 40;
constexpr double kTolerance = 1e-3;
// Below this a face has lost a dimension: there is no direction to stretch it in.
constexpr double kCollapsed = 1e-9;

}  // namespace

ShapeGradients shape_gradients(const Topology& mesh, Eigen::Index face) {
  const auto uv = [&](int k) -> Eigen::Vector2d { return mesh.uv.row(mesh.uv_faces(face, k)).cast<double>(); };
  Eigen::Matrix2d edges;
  edges << uv(1) - uv(0), uv(2) - uv(0);
  ShapeGradients gradients;
  gradients.rightCols<2>() = edges.inverse().transpose();
  gradients.col(0) = -gradients.col(1) - gradients.col(2);
  return gradients;
}

PrincipalStretches principal_stretches(const ShapeGradients& gradients, const Eigen::Matrix3d& corners) {
  const Eigen::Matrix<double, 3, 2> f = corners * gradients.transpose();
  const double c00 = f.col(0).squaredNorm(), c11 = f.col(1).squaredNorm(), c01 = f.col(0).dot(f.col(1));
  const double mean = (c00 + c11) / 2, half_difference = (c00 - c11) / 2;
  const double radius = std::hypot(half_difference, c01);
  const double angle = radius > 0 ? std::atan2(c01, half_difference) / 2 : 0;
  PrincipalStretches result;
  result.stretch = {std::sqrt(mean + radius), std::sqrt(std::max(mean - radius, 0.0))};
  result.directions << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  return result;
}

StrainLimits::StrainLimits(const Topology& mesh, const StretchRange& range) : range_(range) {
  if (!range.limits()) return;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    faces_.push_back({{mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2)}, shape_gradients(mesh, f)});
  }
}

// Brings the face into the range to first order. Returns by how much it was out of it. The gradients of both stretches
// are orthogonal, so that one step serves both.
double StrainLimits::project_face(const Face& face, std::span<Eigen::Vector3d> x,
                                  std::span<const double> inverse_masses) const {
  Eigen::Matrix3d corners;
  for (int k = 0; k < 3; ++k) corners.col(k) = x[face.v[static_cast<std::size_t>(k)]];
  const PrincipalStretches now = principal_stretches(face.gradients, corners);
  double worst = 0;
  for (int s = 0; s < 2; ++s) {
    const double stretch = now.stretch[static_cast<std::size_t>(s)];
    const double excess = stretch - std::clamp(stretch, range_.minimum, range_.maximum);
    if (excess == 0 || stretch < kCollapsed) continue;
    // d stretch / d x_i = (direction . gradient_i) times the direction's unit image.
    const Eigen::RowVector3d along = now.directions.col(s).transpose() * face.gradients;
    const Eigen::Vector3d image = corners * along.transpose() / stretch;
    double mobility = 0;
    for (int k = 0; k < 3; ++k) mobility += inverse_masses[face.v[static_cast<std::size_t>(k)]] * along[k] * along[k];
    if (mobility <= 0) continue;
    worst = std::max(worst, std::abs(excess));
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = face.v[static_cast<std::size_t>(k)];
      x[v] -= excess / mobility * inverse_masses[v] * along[k] * image;
    }
  }
  return worst;
}

bool StrainLimits::project(std::span<Eigen::Vector3d> positions, std::span<const double> inverse_masses) const {
  bool moved = false;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    double worst = 0;
    for (std::size_t i = 0; i < faces_.size(); ++i) {
      // Forwards and backwards in turn: what hangs on a handle learns of it in two sweeps, whatever the faces' order.
      const Face& face = sweep % 2 == 0 ? faces_[i] : faces_[faces_.size() - 1 - i];
      worst = std::max(worst, project_face(face, positions, inverse_masses));
    }
    moved = moved || worst > 0;
    if (worst <= kTolerance) break;
  }
  return moved;
}

}  // namespace pleat::simulation
