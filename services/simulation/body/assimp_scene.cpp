#include "services/simulation/body/assimp_scene.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "common/base/error.hpp"

namespace pleat::body {
namespace {

using Eigen::Affine3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kSlowestRate = 30;     // samples a second
constexpr double kTicksPerSecond = 25;  // where the file does not say, as assimp's documentation has it

}  // namespace

RigidTransform to_rigid(const Affine3d& transform) {
  // rotation() is the nearest rotation: an SVD, which values that are not finite must not reach.
  if (!transform.matrix().allFinite())
    return {Quaterniond::Identity(), Vector3d::Constant(std::numeric_limits<double>::quiet_NaN())};
  return {Quaterniond(transform.rotation()).normalized(), transform.translation()};
}

AssimpJoints::AssimpJoints(const aiScene& scene, const std::string& source) {
  std::set<std::string> bones;
  for (unsigned m = 0; m < scene.mNumMeshes; ++m)
    for (unsigned b = 0; b < scene.mMeshes[m]->mNumBones; ++b) bones.insert(scene.mMeshes[m]->mBones[b]->mName.C_Str());
  std::set<std::string> wanted = bones;
  for (unsigned a = 0; a < scene.mNumAnimations; ++a) {
    auto& channels = channels_[scene.mAnimations[a]];
    for (unsigned c = 0; c < scene.mAnimations[a]->mNumChannels; ++c) {
      const aiNodeAnim* channel = scene.mAnimations[a]->mChannels[c];
      channels.emplace(channel->mNodeName.C_Str(), channel);
      wanted.insert(channel->mNodeName.C_Str());
    }
  }
  if (scene.mRootNode != nullptr) nodes_.push_back({scene.mRootNode, -1, -1});
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    const aiNode* node = nodes_[n].node;
    int above = nodes_[n].parent;
    while (above >= 0 && nodes_[static_cast<std::size_t>(above)].joint < 0)
      above = nodes_[static_cast<std::size_t>(above)].parent;
    const int parent = above < 0 ? -1 : nodes_[static_cast<std::size_t>(above)].joint;
    const std::string name = node->mName.C_Str();
    const bool placement = parent < 0 && !bones.contains(name) && only_places(*node);
    if ((wanted.contains(name) && !placement) || (parent >= 0 && node->mNumMeshes == 0)) {
      nodes_[n].joint = static_cast<int>(joints_.size());
      joints_.push_back({name, parent});
      if (!by_name_.emplace(name, nodes_[n].joint).second)
        throw_invalid_argument(source + ": two joints are called '" + name + "'");
    }
    for (unsigned c = 0; c < node->mNumChildren; ++c) nodes_.push_back({node->mChildren[c], static_cast<int>(n), -1});
  }
}

/// FBX has keys for every node: one that stands still above joints that go somewhere is where they are, no joint.
bool AssimpJoints::only_places(const aiNode& node) const {
  return std::any_of(channels_.begin(), channels_.end(), [&](const auto& animation) {
    const auto own = animation.second.find(node.mName.C_Str());
    if (own != animation.second.end() && (keys_change(own->second->mPositionKeys, own->second->mNumPositionKeys) ||
                                          keys_change(own->second->mRotationKeys, own->second->mNumRotationKeys)))
      return false;
    return std::any_of(node.mChildren, node.mChildren + node.mNumChildren, [&](const aiNode* child) {
      const auto channel = animation.second.find(child->mName.C_Str());
      return channel != animation.second.end() &&
             keys_change(channel->second->mPositionKeys, channel->second->mNumPositionKeys);
    });
  });
}

int AssimpJoints::find(const std::string& name) const {
  const auto found = by_name_.find(name);
  return found == by_name_.end() ? -1 : found->second;
}

std::vector<Affine3d> AssimpJoints::world(const aiAnimation* animation, double ticks) const {
  std::vector<Affine3d> nodes(nodes_.size()), joints(joints_.size());
  const auto* channels = animation == nullptr ? nullptr : &channels_.at(animation);
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    const Node& node = nodes_[n];
    Affine3d local = to_affine(node.node->mTransformation);
    if (channels != nullptr) {
      const auto channel = channels->find(node.node->mName.C_Str());
      if (channel != channels->end()) local = transform_at(*channel->second, ticks);
    }
    nodes[n] = node.parent < 0 ? local : nodes[static_cast<std::size_t>(node.parent)] * local;
    if (node.joint >= 0) joints[static_cast<std::size_t>(node.joint)] = nodes[n];
  }
  return joints;
}

AnimationRange range_of(const aiAnimation& animation) {
  AnimationRange range;
  range.ticks_per_second = animation.mTicksPerSecond > 0 ? animation.mTicksPerSecond : kTicksPerSecond;
  range.first = std::numeric_limits<double>::infinity();
  range.last = -range.first;
  unsigned keys = 1;
  const auto take = [&](const auto* values, unsigned count) {
    if (count == 0) return;
    range.first = std::min(range.first, values[0].mTime);
    range.last = std::max(range.last, values[count - 1].mTime);
    keys = std::max(keys, count);
  };
  for (unsigned c = 0; c < animation.mNumChannels; ++c) {
    take(animation.mChannels[c]->mPositionKeys, animation.mChannels[c]->mNumPositionKeys);
    take(animation.mChannels[c]->mRotationKeys, animation.mChannels[c]->mNumRotationKeys);
  }
  if (!(range.last > range.first)) {
    range.first = range.last = 0;
    return range;
  }
  range.step = keys > 1 ? (range.last - range.first) / (keys - 1) : range.last - range.first;
  range.step /= std::max(1.0, std::ceil(range.step / range.ticks_per_second * kSlowestRate - 1e-6));
  return range;
}

}  // namespace pleat::body
