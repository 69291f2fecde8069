#include "services/simulation/elements.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <random>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Vec3 = Eigen::Vector3d;
using Vector9 = Eigen::Matrix<double, 9, 1>;
using Matrix9 = Eigen::Matrix<double, 9, 9>;
using Vector12 = Eigen::Matrix<double, 12, 1>;

class Random {
 public:
  double in(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vec3 point() { return {in(-1, 1), in(-1, 1), in(-1, 1)}; }

 private:
  std::mt19937 engine_{11};
};

TriangleRest<double> rest_of(const Eigen::Vector2d& u0, const Eigen::Vector2d& u1, const Eigen::Vector2d& u2) {
  Eigen::Matrix2d edges;
  edges << u1 - u0, u2 - u0;
  const Eigen::Matrix2d inverse = edges.inverse();
  TriangleRest<double> rest;
  rest.du = {-inverse(0, 0) - inverse(1, 0), inverse(0, 0), inverse(1, 0)};
  rest.dv = {-inverse(0, 1) - inverse(1, 1), inverse(0, 1), inverse(1, 1)};
  rest.area = edges.determinant() / 2;
  return rest;
}

TriangleStrain<double> strain_of(const TriangleRest<double>& rest, const Vector9& x) {
  return triangle_strain<double>(rest, x.segment<3>(3) - x.head<3>(), x.tail<3>() - x.head<3>());
}

struct RandomTriangle {
  TriangleRest<double> rest;
  Vector9 x;
  Moduli k;
};

RandomTriangle random_triangle(Random& random) {
  RandomTriangle t;
  t.rest = rest_of({random.in(-0.2, 0.2), random.in(-0.2, 0.2)}, {1 + random.in(-0.2, 0.2), random.in(-0.2, 0.2)},
                   {random.in(-0.2, 0.2), 1 + random.in(-0.2, 0.2)});
  t.x << random.point() * 0.3, Vec3(1, 0, 0) + random.point() * 0.3, Vec3(0, 1, 0) + random.point() * 0.3;
  const double k1 = random.in(10, 100), k2 = random.in(10, 100);
  t.k = {static_cast<float>(k1), static_cast<float>(random.in(0, 0.9) * std::sqrt(k1 * k2)), static_cast<float>(k2),
         static_cast<float>(random.in(1, 50))};
  return t;
}

Vector9 forces_of(const RandomTriangle& t, const Vector9& x) {
  Vec3 f1, f2;
  stretching_forces(t.rest, t.k, strain_of(t.rest, x), f1, f2);
  Vector9 f;
  f << -(f1 + f2), f1, f2;
  return f;
}

Matrix9 stiffness_of(const RandomTriangle& t) {
  std::array<Eigen::Matrix3d, 3> blocks;
  stretching_stiffness(t.rest, t.k, strain_of(t.rest, t.x), blocks);
  Matrix9 k = Matrix9::Zero();
  for (int e = 0; e < 3; ++e) {
    const int a = e, b = (e + 1) % 3;
    k.block<3, 3>(3 * a, 3 * b) = blocks[static_cast<std::size_t>(e)];
    k.block<3, 3>(3 * b, 3 * a) = blocks[static_cast<std::size_t>(e)].transpose();
  }
  for (int a = 0; a < 3; ++a) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (int b = 0; b < 3; ++b) {
      if (b != a) sum += k.block<3, 3>(3 * a, 3 * b);
    }
    k.block<3, 3>(3 * a, 3 * a) = -sum;
  }
  return k;
}

TEST(Stretching, ForcesAreTheGradientOfTheEnergy) {
  Random random;
  for (int i = 0; i < 50; ++i) {
    const RandomTriangle t = random_triangle(random);
    const Vector9 f = forces_of(t, t.x);
    for (int d = 0; d < 9; ++d) {
      Vector9 plus = t.x, minus = t.x;
      plus[d] += 1e-6;
      minus[d] -= 1e-6;
      const double slope = (stretching_energy(t.rest, t.k, strain_of(t.rest, plus)) -
                            stretching_energy(t.rest, t.k, strain_of(t.rest, minus))) /
                           2e-6;
      EXPECT_NEAR(f[d], -slope, 1e-6 * (1 + f.norm()));
    }
  }
}

TEST(Stretching, StiffnessIsSymmetricAndPositive) {
  Random random;
  for (int i = 0; i < 200; ++i) {
    const Matrix9 k = stiffness_of(random_triangle(random));
    EXPECT_LT((k - k.transpose()).norm(), 1e-9 * k.norm());
    const auto values = Eigen::SelfAdjointEigenSolver<Matrix9>(k).eigenvalues();
    EXPECT_GT(values.minCoeff(), -1e-9 * values.maxCoeff());
  }
}

TEST(Stretching, StiffnessIsTheForcesDerivativeUnderTension) {
  // Stretched in both directions without shear, nothing is left out.
  Random random;
  for (int i = 0; i < 20; ++i) {
    RandomTriangle t = random_triangle(random);
    t.rest = rest_of({0, 0}, {1, 0}, {0, 1});
    const Eigen::Matrix3d turn = rotation_matrix(random.point());
    t.x << Vec3::Zero(), turn * Vec3(random.in(1, 1.4), 0, 0), turn * Vec3(0, random.in(1, 1.4), 0);
    const Matrix9 k = stiffness_of(t);
    for (int d = 0; d < 9; ++d) {
      Vector9 plus = t.x, minus = t.x;
      plus[d] += 1e-6;
      minus[d] -= 1e-6;
      const Vector9 slope = (forces_of(t, plus) - forces_of(t, minus)) / 2e-6;
      EXPECT_LT((k.col(d) + slope).norm(), 1e-5 * k.norm());
    }
  }
}

TEST(Stretching, RigidMotionAndRestAreFree) {
  Random random;
  const auto rest = rest_of({0, 0}, {1, 0}, {0, 1});
  const Eigen::Matrix3d turn = rotation_matrix(random.point());
  const auto strain = triangle_strain<double>(rest, turn.col(0), turn.col(1));
  EXPECT_NEAR(strain.g00, 0, 1e-12);
  EXPECT_NEAR(strain.g11, 0, 1e-12);
  EXPECT_NEAR(strain.g01, 0, 1e-12);
}

struct Hinge {
  Vector12 x;
  HingeAngle<double> angle() const { return at(x); }
  static HingeAngle<double> at(const Vector12& x) {
    return hinge_angle<double>(x.segment<3>(3) - x.head<3>(), x.segment<3>(6) - x.head<3>(), x.tail<3>() - x.head<3>());
  }
};

// Edge along z from the origin; wings to +-x that fold by `theta`.
Vector12 folded(double theta) {
  Vector12 x;
  x << 0, 0, 0, 0, 0, 1, std::cos(theta / 2), std::sin(theta / 2), 0.4, -std::cos(theta / 2), std::sin(theta / 2), 0.6;
  return x;
}

TEST(Bending, AngleOfAFold) {
  for (const double theta : {0.0, 0.3, 1.5, 3.0, -0.3, -2.0}) {
    EXPECT_NEAR(std::abs(Hinge::at(folded(theta)).theta), std::abs(theta), 1e-12) << theta;
  }
  EXPECT_LT(Hinge::at(folded(0.5)).theta * Hinge::at(folded(-0.5)).theta, 0);
}

TEST(Bending, GradientIsTheAnglesDerivative) {
  Random random;
  for (int i = 0; i < 100; ++i) {
    Vector12 x = folded(random.in(-2.5, 2.5));
    for (int d = 0; d < 12; ++d) x[d] += random.in(-0.1, 0.1);
    const auto angle = Hinge::at(x);
    Vec3 sum = Vec3::Zero();
    for (int d = 0; d < 12; ++d) {
      Vector12 plus = x, minus = x;
      plus[d] += 1e-6;
      minus[d] -= 1e-6;
      const double slope = (Hinge::at(plus).theta - Hinge::at(minus).theta) / 2e-6;
      EXPECT_NEAR(angle.gradient[static_cast<std::size_t>(d / 3)][d % 3], slope, 1e-6);
    }
    for (const Vec3& g : angle.gradient) sum += g;
    EXPECT_LT(sum.norm(), 1e-12);
  }
}

TEST(Bending, MomentIsTheEnergysDerivative) {
  HingeRest<double> rest{0.7, 12.0, {1e-5, 3e-5, 2e-5, 2e-5, 1e-5}};
  for (const double theta : {-1.0, 0.1, 0.8}) {
    const double ke = hinge_stiffness(rest, theta);
    const double slope = (hinge_energy(rest, ke, theta + 1e-6) - hinge_energy(rest, ke, theta - 1e-6)) / 2e-6;
    EXPECT_NEAR(hinge_moment(rest, ke, theta), slope, 1e-12);
    EXPECT_NEAR(hinge_curvature(rest, ke) * theta, hinge_moment(rest, ke, theta), 1e-18);
    EXPECT_EQ(ke, hinge_stiffness(rest, -theta));
  }
  EXPECT_NEAR(hinge_stiffness(rest, 10 / 12.0), 3e-5, 1e-12);
  EXPECT_NEAR(hinge_stiffness(rest, 1e6), 1e-5, 1e-18);
}

TEST(Bending, CollapsedFacesGiveFiniteGradients) {
  Vector12 x = folded(0.2);
  x.segment<3>(6) = Vec3(0, 0, 0.5);  // the first wing lies on the edge
  for (const Vec3& g : Hinge::at(x).gradient) EXPECT_TRUE(g.allFinite());
  x.setZero();
  for (const Vec3& g : Hinge::at(x).gradient) EXPECT_TRUE(g.allFinite());
}

}  // namespace
}  // namespace pleat::simulation
