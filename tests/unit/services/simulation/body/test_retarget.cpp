#include "services/simulation/body/retarget.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

using Eigen::Vector3d;

TEST(Retarget, TheSameSkeletonMovesTheSame) {
  const Motion motion = wild_motion(figure(10, 1, 25), 12);
  const Retargeted same = retarget(motion, motion.skeleton, "a", "b");
  for (std::size_t k = 0; k < motion.frames.size(); ++k)
    EXPECT_TRUE(same_world(world_transforms(motion.skeleton, same.motion.frames[k]),
                           world_transforms(motion.skeleton, motion.frames[k]), 1e-7));
  EXPECT_TRUE(same.notes.empty());
}

TEST(Retarget, AnotherSizeScalesEveryPlace) {
  const Motion motion = wild_motion(figure(), 12);
  const Retargeted large = retarget(motion, figure(0, 1.5), "a", "b");
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    auto expected = world_transforms(motion.skeleton, motion.frames[k]);
    for (RigidTransform& joint : expected) joint.translation *= 1.5;
    EXPECT_TRUE(same_world(world_transforms(large.motion.skeleton, large.motion.frames[k]), expected, 1e-7));
  }
  ASSERT_EQ(large.notes.size(), 1U);
  EXPECT_THAT(large.notes[0], testing::HasSubstr("scaled by 1.5"));
}

TEST(Retarget, AnotherRestPoseAndOtherAxesGiveTheSameFigure) {
  // The arm hangs down at rest and the joints have other axes: the bones must point where the source's do.
  const Motion motion = wild_motion(figure(), 12);
  const Skeleton target = figure(60, 1, 40);
  const Motion result = retarget(motion, target, "a", "b").motion;
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    const auto from = world_transforms(motion.skeleton, motion.frames[k]),
               to = world_transforms(target, result.frames[k]);
    for (std::size_t j = 0; j < from.size(); ++j)
      EXPECT_LT((from[j].translation - to[j].translation).norm(), 1e-7) << j;
  }
}

TEST(Retarget, JointsThatOneSideLacksAreNamed) {
  const Motion motion = wild_motion(figure(), 12);
  Skeleton target = figure();
  target.joints[3].name = "Elbow";
  const Retargeted result = retarget(motion, target, "walk.bvh", "body.glb");
  EXPECT_THAT(result.notes,
              testing::ElementsAre("joints of the motion that the body lacks: LeftForeArm",
                                   "joints of the body that the motion lacks keep their rest pose: Elbow"));
  for (std::size_t j = 2; j < 7; ++j) target.joints[j].name = std::string("b").append(std::to_string(j));
  EXPECT_EQ(message_of([&] { retarget(motion, target, "walk.bvh", "body.glb"); }),
            "the motion of walk.bvh does not fit body.glb: 5 of the 8 joints that the motion turns do not exist in the "
            "body: LeftArm, LeftForeArm, LeftHand, LeftUpLeg, LeftLeg");
  for (std::size_t j = 0; j < 8; ++j) target.joints[j].name = std::string("b").append(std::to_string(j));
  EXPECT_THAT(message_of([&] { retarget(motion, target, "walk.bvh", "body.glb"); }),
              testing::HasSubstr("no joint of one has a name of the other"));
}

}  // namespace
}  // namespace pleat::body
