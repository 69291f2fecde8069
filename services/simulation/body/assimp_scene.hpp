// An assimp scene as joints and matrices: what character_file makes a body and motions of.
#pragma once

#include <assimp/scene.h>

#include <Eigen/Geometry>
#include <map>
#include <string>
#include <vector>

#include "common/mesh/assimp_nodes.hpp"
#include "services/simulation/body/motion.hpp"

namespace pleat::body {

RigidTransform to_rigid(const Eigen::Affine3d& transform);

/// The nodes of a scene that are joints: bones of meshes, nodes that are animated, and nodes without a mesh below them.
/// Indices of joints are in this order, parents first.
class AssimpJoints {
 public:
  /// Throws kInvalidArgument if two joints have one name.
  AssimpJoints(const aiScene& scene, const std::string& source);

  std::size_t size() const { return joints_.size(); }
  /// -1 if the node is no joint.
  int find(const std::string& name) const;
  const std::string& name(std::size_t joint) const { return joints_[joint].name; }
  int parent(std::size_t joint) const { return joints_[joint].parent; }

  /// File units. World transforms as the nodes are in the file.
  std::vector<Eigen::Affine3d> at_rest() const { return world(nullptr, 0); }
  /// As the animation has them at a time, in ticks.
  std::vector<Eigen::Affine3d> at(const aiAnimation& animation, double ticks) const { return world(&animation, ticks); }

 private:
  struct Node {
    const aiNode* node = nullptr;
    int parent = -1;  // an earlier node
    int joint = -1;
  };
  struct JointNode {
    std::string name;
    int parent = -1;
  };
  std::vector<Eigen::Affine3d> world(const aiAnimation* animation, double ticks) const;
  bool only_places(const aiNode& node) const;

  std::vector<Node> nodes_;
  std::vector<JointNode> joints_;
  std::map<std::string, int> by_name_;
  // Channels of each animation by node, in the scene's order.
  std::map<const aiAnimation*, std::map<std::string, const aiNodeAnim*>> channels_;
};

/// First and last key of an animation and the time between samples, in ticks: the finest channel's keys, and no longer
/// than a thirtieth of a second.
struct AnimationRange {
  double first = 0, last = 0, step = 1;
  double ticks_per_second = 25;
};
AnimationRange range_of(const aiAnimation& animation);

}  // namespace pleat::body
