#include "services/simulation/body/animated_body.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <set>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

std::filesystem::path bodies() { return std::filesystem::path(std::getenv("PLEAT_SOURCE_DIR")) / "deploy/bodies"; }

class ShippedBodies : public testing::TestWithParam<const char*> {};

TEST_P(ShippedBodies, AreClosedStandOnTheFloorAndSpreadTheirArms) {
  const AnimatedBody body({bodies() / GetParam(), {}, {}}, {}, Skinning::kLinear);
  const SkinnedMesh& mesh = body.mesh();
  EXPECT_EQ(mesh.mesh.vertex_count(), 13'380);
  EXPECT_EQ(mesh.mesh.face_count(), 26'756);  // 2 V - 4: one closed surface without handles
  EXPECT_EQ(mesh.skeleton.size(), 31U);
  const Positions& x = mesh.mesh.rest_positions;
  EXPECT_NEAR(x.col(1).minCoeff(), 0, 1e-5F);
  EXPECT_GT(x.col(1).maxCoeff(), 1.55F);
  EXPECT_LT(x.col(1).maxCoeff(), 1.9F);
  const auto joints = world_transforms(mesh.skeleton, rest_pose(mesh.skeleton));
  const auto at = [&](const char* name) {
    return joints[static_cast<std::size_t>(mesh.skeleton.find(name))].translation;
  };
  EXPECT_NEAR(at("LeftArm").y(), at("LeftHand").y(), 1e-5);
  EXPECT_NEAR(at("RightArm").y(), at("RightHand").y(), 1e-5);
  EXPECT_GT(at("LeftHand").x(), 0.5);
  EXPECT_EQ(body.frame_count(), 1U);
  EXPECT_TRUE(body.notes().empty());
}

INSTANTIATE_TEST_SUITE_P(Bodies, ShippedBodies, testing::Values("young-female.glb", "young-male.glb"));

TEST(AnimatedBody, DancesTheShippedMotionOnTheFloorFromItsTPose) {
  MotionOptions options;
  options.ease_frames = 20;
  const AnimatedBody body({bodies() / "young-female.glb", bodies() / "lambada.amc", {}}, options, Skinning::kLinear);
  EXPECT_EQ(body.frame_count(), 20U + 454U);  // 2,180 frames at 120 a second, every 0.04 s
  EXPECT_LT((body.positions(0) - body.mesh().mesh.rest_positions).cwiseAbs().maxCoeff(), 1e-5F);
  float lowest = 1, highest = 0;
  for (std::size_t k = 20; k < body.frame_count(); k += 9) {
    const Positions x = body.positions(k);
    lowest = std::min(lowest, x.col(1).minCoeff());
    highest = std::max(highest, x.col(1).minCoeff());
    EXPECT_GT(x.col(1).maxCoeff(), 1.3F) << "frame " << k;
  }
  // One foot is on the floor all the time: nobody jumps in a lambada.
  EXPECT_GT(lowest, -0.05F);
  EXPECT_LT(highest, 0.08F);
}

TEST(AnimatedBody, LimbsKeepTheirLengths) {
  MotionOptions options;
  const AnimatedBody body({bodies() / "young-male.glb", bodies() / "lambada.amc", {}}, options, Skinning::kLinear);
  const Skeleton& skeleton = body.mesh().skeleton;
  for (std::size_t k = 0; k < body.frame_count(); k += 50)
    for (std::size_t j = 1; j < skeleton.size(); ++j)
      EXPECT_NEAR(body.motion().frames[k].translations[j].norm(), skeleton.joints[j].translation.norm(), 1e-9);
}

}  // namespace
}  // namespace pleat::body
