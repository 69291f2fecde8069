// Small skeletons, motions and a tube around an arm.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <tuple>
#include <vector>

#include "services/simulation/body/motion.hpp"
#include "services/simulation/body/skinned_mesh.hpp"
#include "tests/support/errors.hpp"

namespace pleat::body {

/// The message of the error that work() throws.
template <typename Work>
std::string message_of(const Work& work) {
  return test::error_of(work).what();
}

inline Eigen::Quaterniond turn(double degrees, const Eigen::Vector3d& axis) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(degrees * std::numbers::pi / 180, axis.normalized()));
}

/// hips -> chest -> leftarm -> leftforearm -> lefthand, and hips -> leftupleg -> leftleg -> leftfoot. `drop` turns the
/// rest arm downwards by degrees, `size` scales it all; the axes of the joints are turned by `roll` degrees about x.
inline Skeleton figure(double drop = 0, double size = 1, double roll = 0) {
  const Eigen::Vector3d arm = turn(-drop, Eigen::Vector3d::UnitZ()) * Eigen::Vector3d(0.3, 0, 0);
  const Eigen::Quaterniond axes = turn(roll, Eigen::Vector3d::UnitX());
  const std::vector<std::tuple<std::string, int, Eigen::Vector3d>> rows = {
      {"Hips", -1, {0, 1, 0}},      {"Chest", 0, {0, 0.4, 0}},    {"LeftArm", 1, {0.2, 0, 0}},
      {"LeftForeArm", 2, arm},      {"LeftHand", 3, arm},         {"LeftUpLeg", 0, {0.1, 0, 0}},
      {"LeftLeg", 5, {0, -0.5, 0}}, {"LeftFoot", 6, {0, -0.5, 0}}};
  Skeleton skeleton;
  for (const auto& [name, parent, offset] : rows) {
    // World offsets in the axes of the parent.
    const Eigen::Vector3d local = parent < 0 ? offset : axes.conjugate() * offset;
    skeleton.joints.push_back({name, parent, size * local, parent < 0 ? axes : Eigen::Quaterniond::Identity()});
  }
  return skeleton;
}

/// Frames in which every joint turns somehow and the root walks.
inline Motion wild_motion(const Skeleton& skeleton, int frames, double size = 1) {
  Motion motion{skeleton, 0.01, {}};
  for (int k = 0; k < frames; ++k) {
    Pose pose = rest_pose(skeleton);
    for (std::size_t j = 0; j < skeleton.size(); ++j) {
      const double phase = 0.1 * k + static_cast<double>(j);
      const Eigen::Vector3d axis(std::sin(phase), std::cos(2 * phase), 0.3);
      pose.rotations[j] = pose.rotations[j] * turn(40 * std::sin(phase), axis);
    }
    pose.translations[0] += size * Eigen::Vector3d(0.02 * k, 0.05 * std::sin(0.3 * k), 0.01 * k);
    motion.frames.push_back(pose);
  }
  return motion;
}

/// An open tube of square rings along x from 0 to 2 around two joints, at x = 0 and x = 1, with weights that blend over
/// [0.8, 1.2].
inline SkinnedMesh tube() {
  constexpr int kRings = 11, kSides = 4;
  SkinnedMesh body;
  body.skeleton.joints = {{"upper", -1, {0, 0, 0}, Eigen::Quaterniond::Identity()},
                          {"lower", 0, {1, 0, 0}, Eigen::Quaterniond::Identity()}};
  body.mesh.rest_positions.resize(kRings * kSides, 3);
  body.joints = JointIndices::Zero(kRings * kSides, kInfluences);
  body.weights = JointWeights::Zero(kRings * kSides, kInfluences);
  body.mesh.faces.resize((kRings - 1) * kSides * 2, 3);
  for (int ring = 0; ring < kRings; ++ring) {
    const float x = 0.2F * static_cast<float>(ring);
    for (int side = 0; side < kSides; ++side) {
      const Eigen::Index v = ring * kSides + side;
      const double angle = side * std::numbers::pi / 2;
      body.mesh.rest_positions.row(v) << x, static_cast<float>(0.1 * std::cos(angle)),
          static_cast<float>(0.1 * std::sin(angle));
      const float lower = std::clamp((x - 0.8F) / 0.4F, 0.0F, 1.0F);
      body.joints.row(v) << 0, 1, 0, 0;
      body.weights.row(v) << 1 - lower, lower, 0, 0;
      if (ring + 1 == kRings) continue;
      const auto a = static_cast<std::uint32_t>(v), b = static_cast<std::uint32_t>(ring * kSides + (side + 1) % kSides);
      const Eigen::Index f = 2 * v;
      body.mesh.faces.row(f) << a, b, a + kSides;
      body.mesh.faces.row(f + 1) << b, b + kSides, a + kSides;
    }
  }
  return body;
}

/// The largest distance between joints of the two, and the largest angle, must be below 1e-9 and 1e-7.
inline bool same_world(const std::vector<RigidTransform>& a, const std::vector<RigidTransform>& b,
                       double within = 1e-9) {
  for (std::size_t j = 0; j < a.size(); ++j) {
    if ((a[j].translation - b[j].translation).norm() > within) return false;
    if (a[j].rotation.angularDistance(b[j].rotation) > std::max(1e-6, within)) return false;
  }
  return a.size() == b.size();
}

}  // namespace pleat::body
