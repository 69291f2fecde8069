#include "services/simulation/body/skinned_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

using Eigen::Vector3d;

Positions posed(const SkinnedMesh& body, const Eigen::Quaterniond& upper, const Eigen::Quaterniond& lower,
                Skinning how) {
  Pose pose = rest_pose(body.skeleton);
  pose.rotations = {upper, lower};
  return skin(body, world_transforms(body.skeleton, pose), how);
}

class BothSkinnings : public testing::TestWithParam<Skinning> {};

TEST_P(BothSkinnings, RestPoseGivesTheRestMesh) {
  const SkinnedMesh body = tube();
  const Positions x = posed(body, turn(0, Vector3d::UnitX()), turn(0, Vector3d::UnitX()), GetParam());
  EXPECT_LT((x - body.mesh.rest_positions).cwiseAbs().maxCoeff(), 1e-6F);
}

TEST_P(BothSkinnings, ARigidMoveOfAllJointsMovesEveryVertexRigidly) {
  const SkinnedMesh body = tube();
  const RigidTransform move{turn(70, {1, 2, 3}), {0.3, -0.2, 1.5}};
  auto world = world_transforms(body.skeleton, rest_pose(body.skeleton));
  for (RigidTransform& joint : world) joint = move * joint;
  const Positions x = skin(body, world, GetParam());
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    const Vector3d rest = body.mesh.rest_positions.row(v).cast<double>().transpose();
    EXPECT_LT((x.row(v).cast<double>().transpose() - move * rest).norm(), 1e-6);
  }
}

TEST_P(BothSkinnings, ABentElbowTurnsTheLowerPartAboutIt) {
  const SkinnedMesh body = tube();
  const Positions x = posed(body, turn(0, Vector3d::UnitX()), turn(90, Vector3d::UnitZ()), GetParam());
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    const Eigen::Vector3f rest = body.mesh.rest_positions.row(v);
    if (rest.x() > 1.3F) {  // x -> 1 - y, y -> x - 1
      EXPECT_LT((x.row(v).transpose() - Eigen::Vector3f(1 - rest.y(), rest.x() - 1, rest.z())).norm(), 1e-6F);
    } else if (rest.x() < 0.7F) {
      EXPECT_LT((x.row(v).transpose() - rest).norm(), 1e-6F);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Skinning, BothSkinnings, testing::Values(Skinning::kLinear, Skinning::kDualQuaternion));

TEST(SkinnedMesh, TheRingAtATwistedJointShrinksLinearlyAndKeepsItsRadiusAsADualQuaternion) {
  const SkinnedMesh body = tube();
  const Eigen::Quaterniond still = turn(0, Vector3d::UnitX());
  const Positions linear = posed(body, still, turn(120, Vector3d::UnitX()), Skinning::kLinear);
  const Positions dual = posed(body, still, turn(120, Vector3d::UnitX()), Skinning::kDualQuaternion);
  for (Eigen::Index v = 20; v < 24; ++v) {  // the ring at x = 1, weights 1/2 and 1/2
    // The mean of two unit vectors 120 degrees apart has length cos 60.
    EXPECT_NEAR(linear.row(v).tail<2>().norm(), 0.05, 1e-6);
    EXPECT_NEAR(dual.row(v).tail<2>().norm(), 0.1, 1e-6);
    EXPECT_NEAR(dual(v, 0), 1, 1e-6);
  }
}

TEST(SkinnedMesh, FaultsNameTheVertex) {
  SkinnedMesh body = tube();
  body.weights(7, 0) = 0.5F;
  EXPECT_EQ(message_of([&] { validate_skinned_mesh(body, "a"); }), "a: vertex 7: its skinning weights do not sum to 1");
  body = tube();
  body.joints(3, 1) = 9;
  EXPECT_EQ(message_of([&] { validate_skinned_mesh(body, "a"); }), "a: vertex 3 follows joint 9, there are 2");
  body = tube();
  body.weights.conservativeResize(3, kInfluences);
  EXPECT_EQ(message_of([&] { validate_skinned_mesh(body, "a"); }), "a: 3 rows of skinning weights for 44 vertices");
}

}  // namespace
}  // namespace pleat::body
