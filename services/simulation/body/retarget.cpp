#include "services/simulation/body/retarget.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>

#include "common/base/error.hpp"

namespace pleat::body {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kTurns = 0.0175;     // a joint that leaves its rest pose by less than a degree does not move
constexpr double kNoLength = 1e-6;    // of a bone, metres or units of the source
constexpr double kSameSize = 0.02;    // a difference of size that is not worth a line
constexpr std::size_t kMaxNamed = 8;  // joints listed in a message

std::string listed(const std::vector<std::string>& names) {
  std::string text;
  for (std::size_t i = 0; i < std::min(names.size(), kMaxNamed); ++i) text += (i ? ", " : "") + names[i];
  if (names.size() > kMaxNamed) text += " and " + std::to_string(names.size() - kMaxNamed) + " more";
  return text;
}

/// Which joints belong together, and what that says of their rest poses.
class Partners {
 public:
  Partners(const Motion& source, const Skeleton& target)
      : source_(source),
        target_(target),
        source_rest_(world_transforms(source.skeleton, rest_pose(source.skeleton))),
        target_rest_(world_transforms(target, rest_pose(target))) {
    std::map<std::string, int> by_name;
    for (std::size_t j = 0; j < source.skeleton.size(); ++j)
      by_name.emplace(canonical_name(source.skeleton.joints[j].name), static_cast<int>(j));
    for (const Joint& joint : target.joints) {
      const auto found = by_name.find(canonical_name(joint.name));
      of_target_.push_back(found == by_name.end() ? -1 : found->second);
      if (found != by_name.end()) by_name.erase(found);
    }
    children_.resize(target.size());
    for (std::size_t j = 0; j < target.size(); ++j) {
      const int above = ancestor(static_cast<int>(j));
      if (of_target_[j] >= 0 && above >= 0) children_[static_cast<std::size_t>(above)].push_back(j);
    }
    align();
  }

  int of_target(std::size_t joint) const { return of_target_[joint]; }
  const Quaterniond& alignment(std::size_t joint) const { return alignments_[joint]; }
  const std::vector<RigidTransform>& source_rest() const { return source_rest_; }
  const std::vector<RigidTransform>& target_rest() const { return target_rest_; }

  /// The first target joint with a partner; -1 if there is none.
  int root() const {
    const auto found = std::find_if(of_target_.begin(), of_target_.end(), [](int partner) { return partner >= 0; });
    return found == of_target_.end() ? -1 : static_cast<int>(found - of_target_.begin());
  }

  std::vector<std::string> targets_without() const {
    std::vector<std::string> names;
    for (std::size_t j = 0; j < target_.size(); ++j)
      if (of_target_[j] < 0) names.push_back(target_.joints[j].name);
    return names;
  }

  /// Length of the target's leg over the source's.
  double size_ratio() const {
    std::size_t lowest = static_cast<std::size_t>(root());
    for (std::size_t j = 0; j < target_.size(); ++j)
      if (of_target_[j] >= 0 && target_rest_[j].translation.y() < target_rest_[lowest].translation.y() - kNoLength)
        lowest = j;
    double of_target = 0, of_source = 0;
    for (int j = static_cast<int>(lowest), above = ancestor(j); above >= 0; j = above, above = ancestor(j)) {
      of_target += bone(target_rest_, j, above).norm();
      of_source += bone(source_rest_, partner(j), partner(above)).norm();
    }
    if (of_source <= kNoLength) {  // nothing is below the root: all bones that both have
      for (std::size_t j = 0; j < target_.size(); ++j) {
        const int above = of_target_[j] >= 0 ? ancestor(static_cast<int>(j)) : -1;
        if (above < 0) continue;
        of_target += bone(target_rest_, static_cast<int>(j), above).norm();
        of_source += bone(source_rest_, of_target_[j], partner(above)).norm();
      }
    }
    return of_source > kNoLength ? of_target / of_source : 0;
  }

 private:
  int partner(int joint) const { return of_target_[static_cast<std::size_t>(joint)]; }

  static Vector3d bone(const std::vector<RigidTransform>& rest, int end, int start) {
    return rest[static_cast<std::size_t>(end)].translation - rest[static_cast<std::size_t>(start)].translation;
  }

  /// The nearest joint above with a partner.
  int ancestor(int joint) const {
    int above = target_.joints[static_cast<std::size_t>(joint)].parent;
    while (above >= 0 && partner(above) < 0) above = target_.joints[static_cast<std::size_t>(above)].parent;
    return above;
  }

  static bool is_trunk(const std::string& canonical) {
    constexpr std::array<const char*, 9> kTrunk = {"hip",  "pelvis", "spine",    "back",    "chest",
                                                   "neck", "head",   "shoulder", "clavicle"};
    return std::any_of(kTrunk.begin(), kTrunk.end(),
                       [&](const char* word) { return canonical.find(word) != std::string::npos; });
  }

  void align() {
    alignments_.assign(target_.size(), Quaterniond::Identity());
    for (std::size_t j = 0; j < target_.size(); ++j) {
      const int above = ancestor(static_cast<int>(j));
      if (above >= 0) alignments_[j] = alignments_[static_cast<std::size_t>(above)];
      if (of_target_[j] < 0 || children_[j].size() != 1 || is_trunk(canonical_name(target_.joints[j].name))) continue;
      const auto child = static_cast<int>(children_[j].front());
      const Vector3d from = alignments_[j] * bone(target_rest_, child, static_cast<int>(j));
      const Vector3d to = bone(source_rest_, partner(child), of_target_[j]);
      if (from.norm() > kNoLength && to.norm() > kNoLength)
        alignments_[j] = Quaterniond::FromTwoVectors(from, to) * alignments_[j];
    }
  }

  const Motion& source_;
  const Skeleton& target_;
  std::vector<RigidTransform> source_rest_, target_rest_;
  std::vector<int> of_target_;                      // source joint of each target joint, -1: none
  std::vector<std::vector<std::size_t>> children_;  // nearest partnered joints below
  std::vector<Quaterniond> alignments_;
};

/// Joints of the source that leave their rest pose, and which of them move nothing.
void check_partners(const Motion& source, const Partners& partners, std::size_t targets, const std::string& what,
                    std::vector<std::string>& notes) {
  std::vector<bool> used(source.skeleton.size());
  for (std::size_t j = 0; j < targets; ++j)
    if (partners.of_target(j) >= 0) used[static_cast<std::size_t>(partners.of_target(j))] = true;
  std::size_t turning = 0;
  std::vector<std::string> lost;
  for (std::size_t j = 0; j < source.skeleton.size(); ++j) {
    const Joint& joint = source.skeleton.joints[j];
    const bool turns = std::any_of(source.frames.begin(), source.frames.end(), [&](const Pose& pose) {
      return pose.rotations[j].angularDistance(joint.rotation) > kTurns;
    });
    turning += turns ? 1 : 0;
    if (turns && !used[j]) lost.push_back(joint.name);
  }
  if (partners.root() < 0)
    throw_invalid_argument(what + ": no joint of one has a name of the other (the motion has " +
                           listed({source.skeleton.joints.front().name}) + ", ...)");
  if (2 * lost.size() > turning)
    throw_invalid_argument(what + ": " + std::to_string(lost.size()) + " of the " + std::to_string(turning) +
                           " joints that the motion turns do not exist in the body: " + listed(lost));
  if (!lost.empty()) notes.push_back("joints of the motion that the body lacks: " + listed(lost));
}

}  // namespace

Retargeted retarget(const Motion& source, const Skeleton& target, const std::string& source_name,
                    const std::string& target_name) {
  const std::string what = "the motion of " + source_name + " does not fit " + target_name;
  const Partners partners(source, target);
  Retargeted result;
  check_partners(source, partners, target.size(), what, result.notes);
  const double ratio = partners.size_ratio();
  if (!(ratio > 0)) throw_invalid_argument(what + ": the bones that both have have zero length");
  if (const auto without = partners.targets_without(); !without.empty())
    result.notes.push_back("joints of the body that the motion lacks keep their rest pose: " + listed(without));
  if (std::abs(ratio - 1) > kSameSize) {
    std::array<char, 100> text{};
    std::snprintf(text.data(), text.size(), "the motion is scaled by %.4g, the ratio of the lengths of legs", ratio);
    result.notes.emplace_back(text.data());
  }

  const auto root = static_cast<std::size_t>(partners.root());
  result.motion = {target, source.frame_time_s, {}};
  result.motion.frames.reserve(source.frames.size());
  for (const Pose& pose : source.frames) {
    const auto from = world_transforms(source.skeleton, pose);
    std::vector<RigidTransform> world(target.size());
    for (std::size_t j = 0; j < target.size(); ++j) {
      const Joint& joint = target.joints[j];
      const RigidTransform local{joint.rotation, joint.translation};
      world[j] = joint.parent < 0 ? local : world[static_cast<std::size_t>(joint.parent)] * local;
      if (partners.of_target(j) < 0) continue;
      const auto p = static_cast<std::size_t>(partners.of_target(j));
      const Quaterniond turn = from[p].rotation * partners.source_rest()[p].rotation.conjugate();
      world[j].rotation = turn * partners.alignment(j) * partners.target_rest()[j].rotation;
      if (j == root) world[j].translation = ratio * from[p].translation;
    }
    result.motion.frames.push_back(pose_from_world(target, world));
  }
  return result;
}

}  // namespace pleat::body
