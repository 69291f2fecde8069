#include "services/conversion/vertex_features/polar.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>
#include <vector>

#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

Matrix8 pack(const std::vector<Eigen::Matrix3f>& matrices) {
  Matrix8 result;
  for (int lane = 0; lane < 8; ++lane) {
    const Eigen::Matrix3f& m = matrices[static_cast<std::size_t>(lane) % matrices.size()];
    for (int k = 0; k < 9; ++k) result[static_cast<std::size_t>(k)][lane] = m(k / 3, k % 3);
  }
  return result;
}

Eigen::Matrix3f lane_of(const Matrix8& m, int lane) {
  Eigen::Matrix3f result;
  for (int k = 0; k < 9; ++k) result(k / 3, k % 3) = m[static_cast<std::size_t>(k)][lane];
  return result;
}

Eigen::Matrix3f stretch_of(const Polar8& polar, int lane) {
  const auto s = [&](std::size_t k) { return polar.stretch[k][lane]; };
  Eigen::Matrix3f m;
  m << s(0), s(1), s(2), s(1), s(3), s(4), s(2), s(4), s(5);
  return m;
}

void expect_factors(const Matrix8& gradient, const char* what) {
  const Polar8 polar = polar_decomposition(gradient);
  const Quaternion8 named = axes_and_angles(quaternions(polar.rotation));
  const Matrix8 again = rotations_from_vectors({named[0] * named[3], named[1] * named[3], named[2] * named[3]});
  const Matrix8 product = compose(again, polar.stretch);
  for (int lane = 0; lane < 8; ++lane) {
    const Eigen::Matrix3f t = lane_of(gradient, lane), r = lane_of(polar.rotation, lane);
    EXPECT_LT((r.transpose() * r - Eigen::Matrix3f::Identity()).norm(), 3e-6f) << what;
    EXPECT_GT(r.determinant(), 0.99f) << what;
    EXPECT_LT((lane_of(again, lane) - r).norm(), 5e-6f) << what;
    EXPECT_LT((lane_of(product, lane) - t).norm(), 1e-5f * std::max(1.0f, t.norm())) << what << '\n' << t;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> spectrum(stretch_of(polar, lane));
    const Eigen::Vector3f s = spectrum.eigenvalues();
    EXPECT_GE(s(1), -1e-5f) << what;
    if (t.determinant() > 1e-3f) {
      EXPECT_GT(s(0), 0) << what;
    } else if (t.determinant() < -1e-3f) {
      EXPECT_LT(s(0), 0) << what;
      EXPECT_LE(-s(0), s(1) * 1.0001f) << what;
    }
  }
}

TEST(Polar, RotationTimesStretchIsTheMatrix) {
  std::mt19937 random(4);
  std::normal_distribution<float> normal;
  for (int trial = 0; trial < 50; ++trial) {
    std::vector<Eigen::Matrix3f> matrices;
    for (int k = 0; k < 8; ++k) {
      Eigen::Matrix3f m;
      for (int n = 0; n < 9; ++n) m(n / 3, n % 3) = normal(random);
      matrices.push_back(m);  // half of them are reflections
    }
    expect_factors(pack(matrices), "random");
  }
}

TEST(Polar, CollapsedAndReflected) {
  std::vector<Eigen::Matrix3f> matrices(8, Eigen::Matrix3f::Zero());
  matrices[1] = Eigen::Vector3f(1, 1, -1).asDiagonal();
  matrices[2] = Eigen::Vector3f(1, 1, 0).asDiagonal();
  matrices[3] = Eigen::Vector3f(1, 0, 0).asDiagonal();
  matrices[4] = -Eigen::Matrix3f::Identity();
  matrices[5] = Eigen::Vector3f(1, 1e-4f, 1).asDiagonal();
  matrices[6] = Eigen::Vector3f(1e5f, 1, 1).asDiagonal();
  matrices[7] = Eigen::AngleAxisf(3, Eigen::Vector3f(1, 2, 3).normalized()).toRotationMatrix();
  expect_factors(pack(matrices), "special");
}

TEST(Polar, AnglesKeepTheirDigitsNearPi) {
  for (const float angle : {0.0f, 1e-6f, 1e-3f, 1.0f, 3.0f, 3.1415f, 3.14159f}) {
    const Eigen::Vector3f axis = Eigen::Vector3f(0.3f, -0.5f, 0.8f).normalized();
    const Quaternion8 named = axes_and_angles(quaternions(pack({Eigen::AngleAxisf(angle, axis).toRotationMatrix()})));
    EXPECT_NEAR(named[3][0], angle, 3e-6f);
    if (angle < 1e-2f) continue;
    EXPECT_LT((Eigen::Vector3f(named[0][0], named[1][0], named[2][0]) - axis).norm(), 2e-4f) << angle;
  }
}

TEST(Polar, VectorsOfManyTurns) {
  for (const float turns : {-40.0f, -3.0f, -1.0f, 0.0f, 1.0f, 7.0f, 100.0f}) {
    const Eigen::Vector3d axis = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();
    const Eigen::Vector3f v = ((0.7 + 2 * std::numbers::pi * static_cast<double>(turns)) * axis).cast<float>();
    const Eigen::Matrix3d expected =
        Eigen::AngleAxisd(v.cast<double>().norm(), v.cast<double>().normalized()).toRotationMatrix();
    const Matrix8 r = rotations_from_vectors({broadcast8(v.x()), broadcast8(v.y()), broadcast8(v.z())});
    EXPECT_LT((lane_of(r, 5).cast<double>() - expected).norm(), 2e-6 + 1e-6 * std::abs(static_cast<double>(turns)));
  }
}

}  // namespace
}  // namespace pleat::conversion
