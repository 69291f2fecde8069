#include "common/frame/rigid_alignment.hpp"

#include <Eigen/Geometry>
#include <Eigen/SVD>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"

namespace pleat {
namespace {

// Below this ratio of singular values a cloud counts as a line: float positions carry about 1e-7 of their extent.
constexpr double kLineRatio = 1e-6;
constexpr double kPointRatio = 1e-10;

}  // namespace

RigidTransform kabsch(const Positions& positions, const Positions& rest) {
  if (positions.rows() != rest.rows() || positions.rows() == 0) {
    throw_invalid_argument("rigid alignment: " + std::to_string(positions.rows()) + " positions for " +
                           std::to_string(rest.rows()) + " rest positions");
  }
  if (!all_finite(positions)) throw_invalid_argument("rigid alignment: a position is not finite");

  const double inverse_count = 1.0 / static_cast<double>(rest.rows());
  Eigen::Vector3d center = Eigen::Vector3d::Zero(), rest_center = Eigen::Vector3d::Zero();
  for (Eigen::Index v = 0; v < rest.rows(); ++v) {
    center += positions.row(v).cast<double>().transpose();
    rest_center += rest.row(v).cast<double>().transpose();
  }
  center *= inverse_count;
  rest_center *= inverse_count;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double spread = 0;
  for (Eigen::Index v = 0; v < rest.rows(); ++v) {
    const Eigen::Vector3d x = positions.row(v).cast<double>().transpose() - center;
    const Eigen::Vector3d x0 = rest.row(v).cast<double>().transpose() - rest_center;
    covariance += x * x0.transpose();
    spread += x0.squaredNorm();
  }

  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d& s = svd.singularValues();
  if (s(0) > kPointRatio * spread) {
    if (s(1) > kLineRatio * s(0)) {
      const Eigen::Matrix3d& u = svd.matrixU();
      const Eigen::Matrix3d& v = svd.matrixV();
      const double sign = u.determinant() * v.determinant() < 0 ? -1 : 1;
      rotation = v * Eigen::Vector3d(1, 1, sign).asDiagonal() * u.transpose();
    } else {
      rotation = Eigen::Quaterniond::FromTwoVectors(svd.matrixU().col(0), svd.matrixV().col(0)).toRotationMatrix();
    }
  }
  RigidTransform transform;
  transform.rotation = rotation.cast<float>();
  // The rounded rotation is the one that is applied, so the translation belongs to it.
  transform.translation = (rest_center - transform.rotation.cast<double>() * center).cast<float>();
  return transform;
}

}  // namespace pleat
