#include "services/simulation/body/acclaim.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::body {
namespace {

using Eigen::Vector3d;

constexpr const char* kSkeleton = R"(# two bones of one arm, and a head
:version 1.10
:units
  mass 1.0
  length 0.0254
  angle deg
:documentation
  nothing
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lhumerus
    direction 1 0 0
    length 0.3
    axis 0 0 90 XYZ
    dof rx ry rz
    limits (-60 90)
           (-90 120)
  end
  begin
    name lradius
    direction 2 0 0
    length 0.25
    axis 0 0 0 XYZ
    dof rz
  end
  begin
    name head
    direction 0 1 0
    length 0.2
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root lhumerus head
    lhumerus lradius
  end
)";

AcclaimSkeleton skeleton_of(const std::string& text) {
  std::istringstream stream(text);
  return read_asf(stream, "arm.asf");
}

Motion motion_of(const std::string& text) {
  std::istringstream stream(text);
  return read_amc(stream, "arm.amc", skeleton_of(kSkeleton));
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  return text.replace(text.find(from), from.size(), to);
}

TEST(Acclaim, BonesStartWhereTheirParentsEnd) {
  const AcclaimSkeleton arm = skeleton_of(kSkeleton);
  ASSERT_EQ(arm.skeleton.size(), 4U);
  EXPECT_NEAR(arm.metres_per_unit, 1, 1e-12);  // 0.0254 inches to the unit
  const int radius = arm.skeleton.find("lradius");
  ASSERT_GE(radius, 0);
  EXPECT_LT((arm.skeleton.joints[static_cast<std::size_t>(radius)].translation - Vector3d(0.3, 0, 0)).norm(), 1e-12);
}

TEST(Acclaim, AnglesAreMeasuredInTheBonesAxes) {
  // The humerus' axes are turned by 90 degrees about z: its x is the world's y, so rx 90 turns x into -z.
  const Motion motion = motion_of(":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 2 3 0 0 0\nlhumerus 90 0 0\nlradius 0\n");
  ASSERT_EQ(motion.frames.size(), 1U);
  const auto world = world_transforms(motion.skeleton, motion.frames[0]);
  const auto radius = static_cast<std::size_t>(motion.skeleton.find("lradius"));
  EXPECT_LT((world[radius].translation - Vector3d(1, 2, 3 - 0.3)).norm(), 1e-12);
  EXPECT_DOUBLE_EQ(motion.frame_time_s, 1.0 / 120);
}

TEST(Acclaim, TurnsAreAboutXFirst) {
  const Motion motion = motion_of("1\nroot 0 0 0 20 30 40\nlhumerus 0 0 0\nlradius 0\n");
  const Eigen::Quaterniond expected =
      turn(40, Vector3d::UnitZ()) * turn(30, Vector3d::UnitY()) * turn(20, Vector3d::UnitX());
  EXPECT_LT(motion.frames[0].rotations[0].angularDistance(expected), 1e-9);
}

TEST(Acclaim, WhatIsWrongIsNamedWithItsLine) {
  const std::string text = kSkeleton;
  EXPECT_EQ(message_of([&] { skeleton_of(replaced(text, "length 0.3", "length 0")); }),
            "arm.asf line 24: the bone 'lhumerus' has zero length");
  EXPECT_EQ(message_of([&] { skeleton_of(replaced(text, "lhumerus lradius", "lhumerus tail")); }),
            "arm.asf line 41: there is no bone 'tail'");
  EXPECT_EQ(message_of([&] { skeleton_of(replaced(text, "root lhumerus head", "root lhumerus")); }),
            "arm.asf: the bone 'head' does not hang on the root");
  EXPECT_EQ(message_of([] { motion_of("1\nroot 0 0 nan 0 0 0\n"); }), "arm.amc line 2: 'nan' is not a finite number");
  EXPECT_EQ(message_of([] { motion_of("1\nlradius 1 2\n"); }),
            "arm.amc line 2: 'lradius' has 2 values, the skeleton 1 freedoms");
  EXPECT_EQ(message_of([] { motion_of("1\ntail 1\n"); }), "arm.amc line 2: the skeleton has no bone 'tail'");
  EXPECT_EQ(message_of([] { motion_of("root 0 0 0 0 0 0\n"); }),
            "arm.amc line 1: values before the first frame's number");
  EXPECT_EQ(message_of([] { motion_of("# nothing\n"); }), "arm.amc: the motion has no frames");
}

}  // namespace
}  // namespace pleat::body
