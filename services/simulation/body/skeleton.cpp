#include "services/simulation/body/skeleton.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <set>
#include <string_view>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::body {
namespace {

constexpr double kOnePlace = 1e-9;

struct Alias {
  std::string_view other, canonical;
};

// Names without a side.
constexpr std::array<Alias, 12> kMiddle = {{{"root", "hips"},
                                            {"lowerback", "lowerback"},
                                            {"upperback", "spine"},
                                            {"thorax", "spine1"},
                                            {"lowerneck", "neck"},
                                            {"upperneck", "neck1"},
                                            {"cc_base_hip", "hips"},
                                            {"cc_base_waist", "lowerback"},
                                            {"cc_base_spine01", "spine"},
                                            {"cc_base_spine02", "spine1"},
                                            {"cc_base_necktwist01", "neck"},
                                            {"cc_base_necktwist02", "neck1"}}};
// What follows "l"/"r" in CMU's names or "cc_base_l_"/"cc_base_r_" in Reallusion's, and what follows "left"/"right".
constexpr std::array<Alias, 11> kCmuSided = {{{"femur", "upleg"},
                                              {"tibia", "leg"},
                                              {"foot", "foot"},
                                              {"toes", "toebase"},
                                              {"clavicle", "shoulder"},
                                              {"humerus", "arm"},
                                              {"radius", "forearm"},
                                              {"wrist", "hand"},
                                              {"hand", "fingerbase"},
                                              {"fingers", "handindex1"},
                                              {"handfinger1", "handindex1"}}};
constexpr std::array<Alias, 8> kReallusionSided = {{{"thigh", "upleg"},
                                                    {"calf", "leg"},
                                                    {"foot", "foot"},
                                                    {"toebase", "toebase"},
                                                    {"clavicle", "shoulder"},
                                                    {"upperarm", "arm"},
                                                    {"forearm", "forearm"},
                                                    {"hand", "hand"}}};

template <std::size_t kCount>
std::string_view look_up(const std::array<Alias, kCount>& table, std::string_view name) {
  const auto found = std::find_if(table.begin(), table.end(), [name](const Alias& row) { return row.other == name; });
  return found == table.end() ? std::string_view() : found->canonical;
}

}  // namespace

int Skeleton::find(const std::string& name) const {
  const auto found = std::find_if(joints.begin(), joints.end(), [&](const Joint& joint) { return joint.name == name; });
  return found == joints.end() ? -1 : static_cast<int>(found - joints.begin());
}

void validate_skeleton(const Skeleton& skeleton, const std::string& source) {
  if (skeleton.joints.empty()) throw_invalid_argument(source + ": no skeleton");
  std::set<std::string> names;
  double extent = 0;
  for (std::size_t j = 0; j < skeleton.size(); ++j) {
    const Joint& joint = skeleton.joints[j];
    const std::string which = source + ": joint '" + joint.name + "'";
    if (joint.parent < -1 || joint.parent >= static_cast<int>(j))
      throw_invalid_argument(which + " does not come after its parent");
    if (!names.insert(joint.name).second) throw_invalid_argument(which + " exists twice");
    if (!joint.translation.allFinite() || !joint.rotation.coeffs().allFinite())
      throw_invalid_argument(which + " is not finite");
    if (!(std::abs(joint.rotation.norm() - 1) < 1e-3)) throw_invalid_argument(which + " has no rotation of length 1");
    if (joint.parent >= 0) extent = std::max(extent, joint.translation.norm());
  }
  if (skeleton.size() > 1 && extent < kOnePlace)
    throw_invalid_argument(source + ": every bone has zero length (all joints are in one place)");
}

Pose rest_pose(const Skeleton& skeleton) {
  Pose pose;
  for (const Joint& joint : skeleton.joints) {
    pose.rotations.push_back(joint.rotation);
    pose.translations.push_back(joint.translation);
  }
  return pose;
}

std::vector<RigidTransform> world_transforms(const Skeleton& skeleton, const Pose& pose) {
  std::vector<RigidTransform> world(skeleton.size());
  for (std::size_t j = 0; j < skeleton.size(); ++j) {
    const RigidTransform local{pose.rotations[j], pose.translations[j]};
    const int parent = skeleton.joints[j].parent;
    world[j] = parent < 0 ? local : world[static_cast<std::size_t>(parent)] * local;
  }
  return world;
}

Pose pose_from_world(const Skeleton& skeleton, const std::vector<RigidTransform>& world) {
  Pose pose;
  for (std::size_t j = 0; j < skeleton.size(); ++j) {
    const int parent = skeleton.joints[j].parent;
    const RigidTransform local = parent < 0 ? world[j] : world[static_cast<std::size_t>(parent)].inverse() * world[j];
    pose.rotations.push_back(local.rotation.normalized());
    pose.translations.push_back(local.translation);
  }
  return pose;
}

std::string canonical_name(const std::string& name) {
  std::string bare = name.substr(name.find_last_of(":|") + 1);
  std::transform(bare.begin(), bare.end(), bare.begin(), [](unsigned char c) { return std::tolower(c); });
  if (const auto middle = look_up(kMiddle, bare); !middle.empty()) return std::string(middle);
  constexpr std::string_view kReallusion = "cc_base_";
  for (const auto& [letter, side] : {std::pair{'l', "left"}, std::pair{'r', "right"}}) {
    std::string_view rest = bare;
    if (rest.starts_with(kReallusion)) {
      rest.remove_prefix(kReallusion.size());
      if (rest.size() < 2 || rest[0] != letter || rest[1] != '_') continue;
      const auto found = look_up(kReallusionSided, rest.substr(2));
      if (!found.empty()) return std::string(side).append(found);
    } else if (rest.starts_with(side)) {
      const auto found = look_up(kCmuSided, rest.substr(std::string_view(side).size()));
      if (found == "handindex1") return std::string(side).append(found);
    } else if (!rest.empty() && rest[0] == letter) {
      const auto found = look_up(kCmuSided, rest.substr(1));
      if (!found.empty()) return std::string(side).append(found);
    }
  }
  return bare.starts_with(kReallusion) ? bare.substr(kReallusion.size()) : bare;
}

std::string other_side(const std::string& canonical) {
  constexpr std::array<Alias, 3> kSides = {{{"left", "right"}, {"lhip", "rhip"}, {"lthumb", "rthumb"}}};
  for (const auto& [left, right] : kSides) {
    if (canonical.starts_with(left)) return std::string(right).append(canonical.substr(left.size()));
    if (canonical.starts_with(right)) return std::string(left).append(canonical.substr(right.size()));
  }
  return canonical;
}

}  // namespace pleat::body
