#include "services/simulation/body/motion.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

using Eigen::Vector3d;

/// One joint that turns about z at a constant speed.
Motion wheel(double degrees_per_frame, int frames) {
  Motion motion{figure(), 0.01, {}};
  for (int k = 0; k < frames; ++k) {
    motion.frames.push_back(rest_pose(motion.skeleton));
    motion.frames.back().rotations[2] = turn(k * degrees_per_frame, Vector3d::UnitZ());
  }
  return motion;
}

TEST(Motion, ResamplingAConstantTurnIsExact) {
  const Motion motion = resample(wheel(3, 100), 0.0035, 0.02);
  ASSERT_EQ(motion.frames.size(), 278U);
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    const double degrees = 3 * (0.02 + 0.0035 * static_cast<double>(k)) / 0.01;
    EXPECT_LT(motion.frames[k].rotations[2].angularDistance(turn(degrees, Vector3d::UnitZ())), 1e-7);
  }
  EXPECT_EQ(resample(wheel(3, 100), 0.01).frames.size(), 100U);
  EXPECT_THAT(message_of([] { resample(wheel(3, 100), 0.01, 1.5); }), testing::HasSubstr("it can't start at 1.5"));
}

TEST(Motion, SmoothingKeepsWhatIsSmoothAndWeakensWhatShakes) {
  const Motion constant = wheel(0, 7);
  const Motion turned = smooth(wheel(5, 40), 2);
  EXPECT_TRUE(same_world(world_transforms(constant.skeleton, smooth(constant, 3).frames[4]),
                         world_transforms(constant.skeleton, constant.frames[4])));
  EXPECT_LT(turned.frames[20].rotations[2].angularDistance(turn(100, Vector3d::UnitZ())), 1e-9);
  Motion shaking = wheel(0, 40);
  for (std::size_t k = 0; k < 40; ++k) shaking.frames[k].rotations[2] = turn(k % 2 ? 4 : -4, Vector3d::UnitZ());
  // The filter's gain at half the frame rate is (1 - 4 + 6 - 4 + 1) / 16 = 0.
  EXPECT_LT(smooth(shaking, 1).frames[20].rotations[2].angularDistance(turn(0, Vector3d::UnitZ())), 1e-3);
}

TEST(Motion, SmoothingTreatsBothSignsOfAQuaternionAlike) {
  const Motion motion = wheel(5, 40);
  Motion flipped = motion;
  for (std::size_t k = 0; k < 40; k += 3) flipped.frames[k].rotations[2].coeffs() *= -1;
  const Motion a = smooth(motion, 1), b = smooth(flipped, 1);
  for (std::size_t k = 0; k < 40; ++k)
    EXPECT_LT(a.frames[k].rotations[2].angularDistance(b.frames[k].rotations[2]), 1e-6);
}

TEST(Motion, EasingStartsAtRestAndArrivesWithoutAJump) {
  const Motion motion = wild_motion(figure(), 20);
  const Motion eased = ease_from_rest(motion, 15);
  ASSERT_EQ(eased.frames.size(), 35U);
  EXPECT_TRUE(same_world(world_transforms(eased.skeleton, eased.frames[0]),
                         world_transforms(eased.skeleton, rest_pose(eased.skeleton))));
  EXPECT_TRUE(same_world(world_transforms(eased.skeleton, eased.frames[15]),
                         world_transforms(motion.skeleton, motion.frames[0])));
  const double first = eased.frames[0].rotations[2].angularDistance(eased.frames[1].rotations[2]);
  const double middle = eased.frames[7].rotations[2].angularDistance(eased.frames[8].rotations[2]);
  EXPECT_LT(first, 0.03 * middle);
  EXPECT_EQ(ease_from_rest(motion, 0).frames.size(), motion.frames.size());
}

TEST(Motion, StartingAtRestTakesHeadingAndPlaceAndKeepsTheRest) {
  Motion motion = wild_motion(figure(), 20);
  for (Pose& pose : motion.frames) pose.rotations[0] = turn(30, {0.2, 1, 0.1}) * pose.rotations[0];
  const Motion moved = start_at_rest(motion);
  const Vector3d rest = motion.skeleton.joints[0].translation, start = moved.frames[0].translations[0];
  EXPECT_NEAR(start.x(), rest.x(), 1e-12);
  EXPECT_NEAR(start.z(), rest.z(), 1e-12);
  EXPECT_NEAR(start.y(), motion.frames[0].translations[0].y(), 1e-12);
  // No twist about Y is left between the rest and the first pose, and the figure is the same from frame to frame.
  EXPECT_NEAR((moved.frames[0].rotations[0] * motion.skeleton.joints[0].rotation.conjugate()).y(), 0, 1e-12);
  for (std::size_t k = 1; k < 20; ++k) {
    const auto distance = [&](const Motion& m) {
      return (world_transforms(m.skeleton, m.frames[k])[4].translation -
              world_transforms(m.skeleton, m.frames[0])[7].translation)
          .norm();
    };
    EXPECT_NEAR(distance(moved), distance(motion), 1e-9);
  }
}

TEST(Motion, MirroringReflectsEveryJoint) {
  // A figure with both arms.
  Skeleton skeleton;
  skeleton.joints = {{"Hips", -1, {0, 1, 0}, Eigen::Quaterniond::Identity()},
                     {"LeftArm", 0, {0.2, 0.4, 0}, Eigen::Quaterniond::Identity()},
                     {"RightArm", 0, {-0.2, 0.4, 0}, Eigen::Quaterniond::Identity()},
                     {"LeftHand", 1, {0.5, 0, 0}, Eigen::Quaterniond::Identity()},
                     {"RightHand", 2, {-0.5, 0, 0}, Eigen::Quaterniond::Identity()}};
  const Motion motion = wild_motion(skeleton, 10), mirrored = mirror(motion);
  const std::vector<std::size_t> partner = {0, 2, 1, 4, 3};
  for (std::size_t k = 0; k < 10; ++k) {
    const auto a = world_transforms(skeleton, motion.frames[k]), b = world_transforms(skeleton, mirrored.frames[k]);
    for (std::size_t j = 0; j < 5; ++j)
      EXPECT_LT((b[partner[j]].translation - a[j].translation.cwiseProduct(Vector3d(-1, 1, 1))).norm(), 1e-12);
    EXPECT_TRUE(same_world(world_transforms(skeleton, mirror(mirrored).frames[k]), a));
  }
  EXPECT_THAT(message_of([] { mirror(wild_motion(figure(), 2)); }),
              testing::HasSubstr("joint 'LeftArm' has no partner"));
}

TEST(Motion, SaysWhereItIsTooFast) {
  Motion motion = wheel(1, 50);  // 100 degrees a second; the hand, 0.6 m away, moves at 1.05 m/s
  motion.frames[30].rotations[2] = turn(60, Vector3d::UnitZ());
  EXPECT_TRUE(find_fast(wheel(1, 50)).empty());
  const SpeedLimits limits{2, 1'200};
  const auto fast = find_fast(motion, limits);
  ASSERT_FALSE(fast.empty());
  EXPECT_EQ(fast[0].joint, "LeftHand");
  EXPECT_EQ(fast[0].frame, 29U);
  EXPECT_NEAR(fast[0].speed, 2 * 0.6 * std::sin(0.5 * 31 * std::numbers::pi / 180) / 0.01, 1e-9);
  EXPECT_EQ(describe(fast[0], limits), "frame 29: LeftHand moves at 32.1 m/s, above 2");
  const auto turning = std::find_if(fast.begin(), fast.end(), [](const FastPlace& place) { return place.turning; });
  ASSERT_NE(turning, fast.end());
  EXPECT_EQ(turning->joint, "LeftArm");
  EXPECT_NEAR(turning->speed, 3'100, 1e-6);
}

TEST(Motion, FaultsNameFrameAndJoint) {
  Motion motion = wheel(1, 4);
  motion.frames[2].rotations[3].x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(message_of([&] { validate_motion(motion, "a.bvh"); }), "a.bvh: frame 2: joint 'LeftForeArm' is not finite");
  EXPECT_EQ(message_of([&] { validate_motion({figure(), 0.01, {}}, "a.bvh"); }), "a.bvh: the motion has no frames");
}

}  // namespace
}  // namespace pleat::body
