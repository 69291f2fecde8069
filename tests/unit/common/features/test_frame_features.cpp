#include "common/features/frame_features.hpp"

#include <gtest/gtest.h>

namespace pleat {
namespace {

TEST(FrameFeatures, FollowTheirDefinitions) {
  Topology mesh;
  mesh.rest_positions.resize(3, 3);
  mesh.rest_positions << 0, 0, 0, 1, 0, 0, 0, 0, -1;
  mesh.faces.resize(1, 3);
  mesh.faces << 0, 1, 2;
  // A quarter turn about y and a shift; the alignment undoes both.
  RigidTransform alignment;
  alignment.rotation << 0, 0, -1, 0, 1, 0, 1, 0, 0;
  alignment.translation << 1, 2, 3;
  const Eigen::Matrix3f inverse = alignment.rotation.transpose();
  Frame frame;
  frame.positions = (mesh.rest_positions.rowwise() - alignment.translation.transpose()) * inverse.transpose();
  Positions previous = frame.positions;
  previous.row(1) -= (inverse * Eigen::Vector3f(0.4f, 0, 0)).transpose();
  frame.velocities = backward_velocities(frame.positions, previous, 0.1);
  FeatureScratch scratch;
  FrameFeatures features;
  frame_features(frame, mesh, alignment, scratch, features);
  EXPECT_LT(features.leftCols<3>().norm(), 1e-6f);
  for (Eigen::Index v = 0; v < 3; ++v) EXPECT_NEAR(features(v, kNormalChannel + 1), 1, 1e-6f);
  EXPECT_NEAR(features(1, kVelocityChannel), 4, 1e-5f);
  EXPECT_NEAR(features.row(0).segment<3>(kVelocityChannel).norm(), 0, 1e-6f);
  frame.velocities.resize(0, 3);
  frame_features(frame, mesh, alignment, scratch, features);
  EXPECT_EQ(features.rightCols<3>().norm(), 0);
}

TEST(FrameFeatures, HaveNineNames) {
  ASSERT_EQ(frame_channel_names().size(), static_cast<std::size_t>(kFrameChannels));
  EXPECT_EQ(frame_channel_names()[kNormalChannel], "normal_x");
  EXPECT_EQ(frame_channel_names()[kVelocityChannel + 2], "velocity_z");
  EXPECT_EQ(find_frame_channels(frame_channel_names(), kVelocityChannel), kVelocityChannel);
  EXPECT_EQ(find_frame_channels({"detail_x", "normal_x"}, kNormalChannel), 1);
  EXPECT_EQ(find_frame_channels({"detail_x", "detail_y"}, kDisplacementChannel), -1);
}

TEST(BackwardVelocities, AreDifferencesOverTime) {
  Positions now(1, 3), before(1, 3);
  now << 2, 2, 1;
  before << 1, 2, 3;
  EXPECT_EQ(backward_velocities(now, before, 0.5), (Positions(1, 3) << 2, 0, -4).finished());
  EXPECT_EQ(backward_velocities(now, Positions(), 0.5), Positions::Zero(1, 3));
}

}  // namespace
}  // namespace pleat
