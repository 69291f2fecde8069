#include "common/frame/rigid_alignment.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>
#include <random>

#include "common/base/error.hpp"

namespace pleat {
namespace {

Positions random_cloud(Eigen::Index count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(-1, 1);
  return Positions::NullaryExpr(count, 3, [&](Eigen::Index, Eigen::Index) { return uniform(random); });
}

RigidTransform some_motion() {
  RigidTransform motion;
  motion.rotation = Eigen::AngleAxisf(1.1f, Eigen::Vector3f(0.3f, -0.5f, 0.8f).normalized()).toRotationMatrix();
  motion.translation = {0.4f, 1.3f, -0.7f};
  return motion;
}

Positions moved(const Positions& positions, const RigidTransform& motion) {
  return (positions * motion.rotation.transpose()).rowwise() + motion.translation.transpose();
}

void expect_rotation(const RigidTransform& t) {
  EXPECT_LT((t.rotation * t.rotation.transpose() - Eigen::Matrix3f::Identity()).norm(), 1e-5f);
  EXPECT_NEAR(t.rotation.determinant(), 1, 1e-5);
}

double residual(const Positions& positions, const RigidTransform& t, const Positions& rest) {
  return static_cast<double>((moved(positions, t) - rest).squaredNorm());
}

TEST(Kabsch, UndoesARigidMotion) {
  const Positions rest = random_cloud(50, 1);
  const RigidTransform t = kabsch(moved(rest, some_motion()), rest);
  expect_rotation(t);
  EXPECT_LT((t.rotation - some_motion().rotation.transpose()).norm(), 1e-5f);
  EXPECT_LT(residual(moved(rest, some_motion()), t, rest), 1e-9);
}

TEST(Kabsch, BeatsEveryPerturbedRotation) {
  const Positions rest = random_cloud(40, 3);
  const Positions cloud = moved(rest + 0.3f * random_cloud(40, 4), some_motion());
  const RigidTransform best = kabsch(cloud, rest);
  expect_rotation(best);
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  for (int i = 0; i < 200; ++i) {
    RigidTransform other = best;
    const Eigen::Vector3f axis = Eigen::Vector3f(normal(random), normal(random), normal(random)).normalized();
    other.rotation = Eigen::AngleAxisf(0.05f * normal(random), axis).toRotationMatrix() * best.rotation;
    other.translation = rest.colwise().mean().transpose() - other.rotation * cloud.colwise().mean().transpose();
    EXPECT_GE(residual(cloud, other, rest), residual(cloud, best, rest) - 1e-4);
  }
}

TEST(Kabsch, AReflectionIsNeverUsed) {
  const Positions rest = random_cloud(30, 6);
  Positions mirrored = rest;
  mirrored.col(0) *= -1;
  const RigidTransform t = kabsch(mirrored, rest);
  expect_rotation(t);
  EXPECT_GT(residual(mirrored, t, rest), 0.1);
}

TEST(Kabsch, FlatCloudsAreDetermined) {
  Positions rest = random_cloud(30, 7);
  rest.col(1).setZero();
  const Positions cloud = moved(rest, some_motion());
  const RigidTransform t = kabsch(cloud, rest);
  expect_rotation(t);
  EXPECT_LT(residual(cloud, t, rest), 1e-9);
  // A flat sheet that is turned over is a rotation by half a turn, not a reflection.
  Positions flipped = rest;
  flipped.col(0) *= -1;
  const RigidTransform half_turn = kabsch(flipped, rest);
  expect_rotation(half_turn);
  EXPECT_LT(residual(flipped, half_turn, rest), 1e-9);
}

TEST(Kabsch, CollinearCloudsGetTheSmallestRotation) {
  Positions rest = Positions::Zero(10, 3), cloud = Positions::Zero(10, 3);
  for (int i = 0; i < 10; ++i) {
    rest(i, 0) = static_cast<float>(i);
    cloud(i, 2) = static_cast<float>(i) + 3;
  }
  const RigidTransform t = kabsch(cloud, rest);
  expect_rotation(t);
  EXPECT_LT(residual(cloud, t, rest), 1e-9);
  EXPECT_LT((t.rotation * Eigen::Vector3f::UnitY() - Eigen::Vector3f::UnitY()).norm(), 1e-5f);
  EXPECT_EQ(kabsch(rest, rest).rotation, Eigen::Matrix3f::Identity());
}

TEST(Kabsch, CoincidentPointsGetTheIdentity) {
  const Positions rest = random_cloud(10, 8);
  const Positions cloud = Eigen::RowVector3f(2, 3, 4).replicate(10, 1);
  const RigidTransform t = kabsch(cloud, rest);
  EXPECT_EQ(t.rotation, Eigen::Matrix3f::Identity());
  EXPECT_LT((t.rotation * Eigen::Vector3f(2, 3, 4) + t.translation - rest.colwise().mean().transpose()).norm(), 1e-5f);
}

TEST(Kabsch, SameInputSameBits) {
  const Positions rest = random_cloud(100, 9), cloud = random_cloud(100, 10);
  const RigidTransform a = kabsch(cloud, rest), b = kabsch(cloud, rest);
  EXPECT_EQ(a.rotation, b.rotation);
  EXPECT_EQ(a.translation, b.translation);
}

TEST(Kabsch, BadInputIsRefused) {
  const Positions rest = random_cloud(10, 11);
  EXPECT_THROW(kabsch(random_cloud(9, 1), rest), Error);
  EXPECT_THROW(kabsch(Positions(0, 3), Positions(0, 3)), Error);
  Positions broken = rest;
  broken(3, 1) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(kabsch(broken, rest), Error);
}

}  // namespace
}  // namespace pleat
