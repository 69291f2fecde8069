#include "services/simulation/body/skeleton.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

TEST(Skeleton, WorldTransformsAreProductsOfMatrices) {
  const Skeleton skeleton = figure(20, 1, 30);
  const Pose pose = wild_motion(skeleton, 5).frames[4];
  const auto world = world_transforms(skeleton, pose);
  for (std::size_t j = 0; j < skeleton.size(); ++j) {
    Eigen::Affine3d product = Eigen::Affine3d::Identity();
    for (int at = static_cast<int>(j); at >= 0; at = skeleton.joints[static_cast<std::size_t>(at)].parent) {
      const auto i = static_cast<std::size_t>(at);
      product = Eigen::Translation3d(pose.translations[i]) * pose.rotations[i] * product;
    }
    EXPECT_LT((world[j].translation - product.translation()).norm(), 1e-12);
    EXPECT_LT((world[j].rotation.toRotationMatrix() - product.linear()).norm(), 1e-12);
  }
  EXPECT_TRUE(same_world(world_transforms(skeleton, pose_from_world(skeleton, world)), world));
}

TEST(Skeleton, NamesOfOtherToolsMeanTheSameJoint) {
  for (const char* name : {"LeftUpLeg", "lfemur", "CC_Base_L_Thigh", "mixamorig:LeftUpLeg"})
    EXPECT_EQ(canonical_name(name), "leftupleg") << name;
  for (const char* name : {"RightForeArm", "rradius", "CC_Base_R_Forearm", "Armature|RightForeArm"})
    EXPECT_EQ(canonical_name(name), "rightforearm") << name;
  EXPECT_EQ(canonical_name("root"), "hips");
  EXPECT_EQ(canonical_name("CC_Base_Hip"), "hips");
  EXPECT_EQ(canonical_name("rhand"), "rightfingerbase");  // CMU's wrist is the hand of the others
  EXPECT_EQ(canonical_name("RightHand"), "righthand");
  EXPECT_EQ(canonical_name("LeftHandFinger1"), "lefthandindex1");
  EXPECT_EQ(canonical_name("Antenna"), "antenna");
  EXPECT_EQ(other_side("leftupleg"), "rightupleg");
  EXPECT_EQ(other_side("rhipjoint"), "lhipjoint");
  EXPECT_EQ(other_side("neck"), "neck");
}

TEST(Skeleton, FaultsNameTheJoint) {
  const auto fault = [](const Skeleton& skeleton) {
    return message_of([&] { validate_skeleton(skeleton, "rig.glb"); });
  };
  EXPECT_EQ(fault({}), "rig.glb: no skeleton");
  Skeleton bad = figure();
  bad.joints[2].parent = 4;
  EXPECT_EQ(fault(bad), "rig.glb: joint 'LeftArm' does not come after its parent");
  bad = figure();
  bad.joints[3].name = "Chest";
  EXPECT_EQ(fault(bad), "rig.glb: joint 'Chest' exists twice");
  bad = figure();
  bad.joints[3].translation.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(fault(bad), "rig.glb: joint 'LeftForeArm' is not finite");
  EXPECT_EQ(fault(figure(0, 0)), "rig.glb: every bone has zero length (all joints are in one place)");
}

}  // namespace
}  // namespace pleat::body
