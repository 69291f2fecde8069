// Skeletons and poses: joints with a rest pose, and where they are when they turn.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <vector>

namespace pleat::body {

/// A joint, relative to its parent: at rest, a point x of the joint is at rotation x + translation in the parent.
struct Joint {
  std::string name;
  int parent = -1;                                        ///< an earlier joint; -1: a root
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< metres
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
};

/// Joints with parents before their children. Y is up, the front looks along +Z, where a reader could tell.
struct Skeleton {
  std::vector<Joint> joints;

  std::size_t size() const { return joints.size(); }
  /// Index of the joint of that name, -1 if there is none. O(joints).
  int find(const std::string& name) const;
};

/// Where joints are relative to their parents; one value per joint.
struct Pose {
  std::vector<Eigen::Quaterniond> rotations;
  std::vector<Eigen::Vector3d> translations;  ///< metres
};

/// A joint in the world: x -> rotation x + translation.
struct RigidTransform {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return rotation * x + translation; }
  RigidTransform operator*(const RigidTransform& inner) const {
    return {rotation * inner.rotation, rotation * inner.translation + translation};
  }
  RigidTransform inverse() const {
    const Eigen::Quaterniond back = rotation.conjugate();
    return {back, back * -translation};
  }
};

/// Throws kInvalidArgument, naming the joint and `source`: no joints, a parent that does not come before its child, two
/// joints of one name, values that are not finite, a rotation without length, or joints that are all in one place.
void validate_skeleton(const Skeleton& skeleton, const std::string& source);

Pose rest_pose(const Skeleton& skeleton);

/// World transforms of all joints in a pose. O(joints).
std::vector<RigidTransform> world_transforms(const Skeleton& skeleton, const Pose& pose);

/// The pose that puts the joints there; the inverse of world_transforms.
Pose pose_from_world(const Skeleton& skeleton, const std::vector<RigidTransform>& world);

/// One name for what mocap skeletons, MotionBuilder, Mixamo and Reallusion call differently: lower case, without a
/// namespace ("mixamorig:"), CMU's and Reallusion's bones by MotionBuilder's names ("lfemur", "CC_Base_L_Thigh" and
/// "LeftUpLeg" are "leftupleg"). Names that are not known stay as they are.
std::string canonical_name(const std::string& name);

/// "leftarm" for "rightarm" and the reverse; the name itself if it has no side. Takes and returns canonical names.
std::string other_side(const std::string& canonical);

}  // namespace pleat::body
