#include "services/dataset/poses.hpp"

#include <gmock/gmock.h>

#include "services/simulation/body/skeleton.hpp"

namespace pleat::dataset {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

// A trunk along y and an arm beside it along y, each a square prism of 0.2 m; the arm hangs from a shoulder above both.
body::SkinnedMesh figure() {
  body::SkinnedMesh body;
  body.skeleton.joints = {{"hips", -1, {0, 0, 0}},
                          {"chest", 0, {0, 0.5, 0}},
                          {"shoulder", 1, {0.25, 0.1, 0}},
                          {"arm", 2, {0.25, 0, 0}},
                          {"hand", 3, {0, -0.6, 0}}};
  std::vector<Eigen::Vector3f> vertices;
  std::vector<int> joints;
  const auto ring = [&](int joint, float x, float y) {
    for (const auto& [dx, dz] : {std::pair{0.1f, 0.1f}, {-0.1f, 0.1f}, {-0.1f, -0.1f}, {0.1f, -0.1f}}) {
      vertices.emplace_back(x + dx, y, dz);
      joints.push_back(joint);
    }
  };
  for (const float y : {0.0f, 0.2f, 0.4f}) ring(0, 0, y);
  for (const float y : {0.6f, 0.0f}) ring(3, 0.5f, y);
  body.mesh.rest_positions.resize(static_cast<Eigen::Index>(vertices.size()), 3);
  body.joints.setZero(body.mesh.rest_positions.rows(), body::kInfluences);
  body.weights.setZero(body.mesh.rest_positions.rows(), body::kInfluences);
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const auto i = static_cast<Eigen::Index>(v);
    body.mesh.rest_positions.row(i) = vertices[v];
    body.joints(i, 0) = static_cast<std::uint16_t>(joints[v]);
    body.weights(i, 0) = 1;
  }
  body.mesh.faces.resize(2, 3);
  body.mesh.faces << 0, 1, 2, 12, 13, 14;
  return body;
}

Positions garment_at(float x, float y, float z) {
  Positions garment(1, 3);
  garment << x, y, z;
  return garment;
}

std::string first_fault(const PoseJudge& judge, const body::Motion& motion) {
  for (const std::string& fault : judge.faults(motion)) {
    if (!fault.empty()) return fault;
  }
  return {};
}

// The arm moves by `offset` over `frames` frames of 0.1 s.
body::Motion arm_moves(const body::SkinnedMesh& body, const Eigen::Vector3d& offset, int frames) {
  body::Motion motion{body.skeleton, 0.1, {}};
  for (int k = 0; k < frames; ++k) {
    body::Pose pose = body::rest_pose(body.skeleton);
    pose.translations[3] += offset * k / (frames - 1);
    motion.frames.push_back(pose);
  }
  return motion;
}

TEST(PoseJudge, ArmsGoBesideATrunkAndNotIntoIt) {
  const body::SkinnedMesh body = figure();
  const PoseJudge judge(body, garment_at(0.15f, 0.2f, 0));
  EXPECT_THAT(first_fault(judge, arm_moves(body, Eigen::Vector3d::Zero(), 2)), IsEmpty());
  EXPECT_THAT(first_fault(judge, arm_moves(body, {-0.22, 0, 0}, 11)), IsEmpty());
  const std::vector<std::string> faults = judge.faults(arm_moves(body, {-0.45, 0, 0}, 11));
  ASSERT_EQ(faults.size(), 11u);
  EXPECT_THAT(faults[4], IsEmpty());
  EXPECT_THAT(faults[10], HasSubstr("hips and arm are"));
  EXPECT_THAT(faults[10], HasSubstr("inside each other"));
}

TEST(PoseJudge, WhatIsFarFromTheGarmentDoesNotMatter) {
  const body::SkinnedMesh body = figure();
  EXPECT_THAT(first_fault(PoseJudge(body, garment_at(0, 0.2f, 5)), arm_moves(body, {-0.45, 0, 0}, 11)), IsEmpty());
}

TEST(PoseJudge, AJointThatFliesIsNamed) {
  const body::SkinnedMesh body = figure();
  EXPECT_THAT(first_fault(PoseJudge(body, garment_at(0, 0.2f, 5)), arm_moves(body, {0, 3, 0}, 2)),
              HasSubstr("arm moves"));
}

TEST(WornJudge, FollowsTheBodyAndSeesWhatSlips) {
  Positions body(2, 3), garment(2, 3);
  body << 0, 0, 0, 1, 0, 0;
  garment << 0, 0.1f, 0, 1, 0.1f, 0;
  const WornJudge judge(garment, body);
  Positions moved = body, worn = garment;
  moved.rowwise() += Eigen::RowVector3f(0, 2, 0);
  worn.rowwise() += Eigen::RowVector3f(0, 1.9f, 0);
  EXPECT_THAT(judge.why_not(worn, moved, 0.01, 1, 4), IsEmpty());
  EXPECT_THAT(judge.why_not(garment, moved, 0.01, 0, 4), HasSubstr("2000 mm from where it was worn"));
  EXPECT_THAT(judge.why_not(worn, moved, 0.15, 0, 4), HasSubstr("150 mm behind"));
  EXPECT_THAT(judge.why_not(worn, moved, 0.01, 5, 4), HasSubstr("5 steps had to be cut"));
}

}  // namespace
}  // namespace pleat::dataset
