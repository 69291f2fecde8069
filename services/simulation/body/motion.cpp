#include "services/simulation/body/motion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <numbers>

#include "common/base/error.hpp"

namespace pleat::body {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::size_t kMaxJointPoses = 20'000'000;

double degrees(double radians) { return radians * 180 / std::numbers::pi; }

/// The heading of a turn: its rotation about Y alone (swing-twist decomposition).
Quaterniond twist_about_y(const Quaterniond& turn) {
  Quaterniond twist(turn.w(), 0, turn.y(), 0);
  return twist.norm() < 1e-9 ? Quaterniond::Identity() : twist.normalized();
}

Pose filtered(const Motion& motion, std::ptrdiff_t frame) {
  constexpr std::array<double, 5> kBinomial = {1.0 / 16, 4.0 / 16, 6.0 / 16, 4.0 / 16, 1.0 / 16};
  const auto last = static_cast<std::ptrdiff_t>(motion.frames.size()) - 1;
  Pose result = motion.frames[static_cast<std::size_t>(frame)];
  for (std::size_t j = 0; j < motion.skeleton.size(); ++j) {
    const Quaterniond middle = result.rotations[j];
    Eigen::Vector4d turn = Eigen::Vector4d::Zero();
    Vector3d place = Vector3d::Zero();
    for (std::ptrdiff_t k = -2; k <= 2; ++k) {
      const Pose& pose = motion.frames[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(frame + k, 0, last))];
      const double weight = kBinomial[static_cast<std::size_t>(k + 2)];
      turn += (pose.rotations[j].dot(middle) < 0 ? -weight : weight) * pose.rotations[j].coeffs();
      place += weight * pose.translations[j];
    }
    result.rotations[j] = Quaterniond(turn).normalized();
    result.translations[j] = place;
  }
  return result;
}

}  // namespace

void validate_motion(const Motion& motion, const std::string& source) {
  validate_skeleton(motion.skeleton, source);
  if (motion.frames.empty()) throw_invalid_argument(source + ": the motion has no frames");
  if (!(motion.frame_time_s > 0) || !std::isfinite(motion.frame_time_s))
    throw_invalid_argument(source + ": the frame time must be positive");
  if (motion.frames.size() > kMaxJointPoses / motion.skeleton.size())
    throw Error(ErrorCode::kResourceExhausted, source + ": " + std::to_string(motion.frames.size()) + " frames of " +
                                                   std::to_string(motion.skeleton.size()) + " joints are too many");
  for (std::size_t k = 0; k < motion.frames.size(); ++k) {
    const Pose& pose = motion.frames[k];
    const std::string frame = source + ": frame " + std::to_string(k);
    if (pose.rotations.size() != motion.skeleton.size() || pose.translations.size() != motion.skeleton.size())
      throw_invalid_argument(frame + " has another number of joints than the skeleton");
    for (std::size_t j = 0; j < motion.skeleton.size(); ++j) {
      const std::string which = frame + ": joint '" + motion.skeleton.joints[j].name + "'";
      if (!pose.rotations[j].coeffs().allFinite() || !pose.translations[j].allFinite())
        throw_invalid_argument(which + " is not finite");
      if (!(std::abs(pose.rotations[j].norm() - 1) < 1e-3))
        throw_invalid_argument(which + " has no rotation of length 1");
    }
  }
}

Pose interpolate(const Pose& a, const Pose& b, double fraction) {
  Pose pose = a;
  for (std::size_t j = 0; j < a.rotations.size(); ++j) {
    pose.rotations[j] = a.rotations[j].slerp(fraction, b.rotations[j]);
    pose.translations[j] = (1 - fraction) * a.translations[j] + fraction * b.translations[j];
  }
  return pose;
}

Pose pose_at(const Motion& motion, double time_s) {
  const auto last = static_cast<double>(motion.frames.size() - 1);
  const double at = std::clamp(time_s / motion.frame_time_s, 0.0, last);
  const auto before = static_cast<std::size_t>(at);
  const std::size_t after = std::min(before + 1, motion.frames.size() - 1);
  return interpolate(motion.frames[before], motion.frames[after], at - static_cast<double>(before));
}

Motion resample(const Motion& motion, double frame_time_s, double start_s, double end_s) {
  if (!(frame_time_s > 0) || !std::isfinite(frame_time_s)) throw_invalid_argument("the frame time must be positive");
  const double duration = std::min(motion.duration_s(), end_s) - start_s;
  if (!(start_s >= 0) || duration < 0)
    throw_invalid_argument("the motion lasts " + std::to_string(motion.duration_s()) + " s, it can't start at " +
                           std::to_string(start_s) + " s");
  Motion result{motion.skeleton, frame_time_s, {}};
  // A thousandth of a frame of rounding must not lose the last one.
  const auto count = static_cast<std::size_t>(duration / frame_time_s + 1e-3) + 1;
  if (count > kMaxJointPoses / std::max<std::size_t>(1, motion.skeleton.size()))
    throw Error(ErrorCode::kResourceExhausted,
                "a frame time of " + std::to_string(frame_time_s) + " s makes too many frames of this motion");
  for (std::size_t k = 0; k < count; ++k)
    result.frames.push_back(pose_at(motion, start_s + frame_time_s * static_cast<double>(k)));
  return result;
}

Motion smooth(const Motion& motion, int rounds) {
  Motion result = motion;
  for (int round = 0; round < rounds; ++round) {
    const Motion before = result;
    for (std::size_t k = 0; k < before.frames.size(); ++k)
      result.frames[k] = filtered(before, static_cast<std::ptrdiff_t>(k));
  }
  return result;
}

Motion ease_from_rest(const Motion& motion, int frames) {
  Motion result{motion.skeleton, motion.frame_time_s, {}};
  const Pose rest = rest_pose(motion.skeleton);
  for (int k = 0; k < frames; ++k) {
    const double u = static_cast<double>(k) / frames;
    result.frames.push_back(interpolate(rest, motion.frames.front(), u * u * u * (10 + u * (6 * u - 15))));
  }
  result.frames.insert(result.frames.end(), motion.frames.begin(), motion.frames.end());
  return result;
}

Motion start_at_rest(const Motion& motion) {
  Motion result = motion;
  if (motion.frames.empty()) return result;
  const auto& joints = motion.skeleton.joints;
  const auto hips = std::find_if(joints.begin(), joints.end(),
                                 [](const Joint& joint) { return canonical_name(joint.name) == "hips"; });
  const auto center = static_cast<std::size_t>(hips == joints.end() ? 0 : hips - joints.begin());
  const RigidTransform rest = world_transforms(motion.skeleton, rest_pose(motion.skeleton))[center];
  const RigidTransform start = world_transforms(motion.skeleton, motion.frames.front())[center];
  const Quaterniond turn = twist_about_y(start.rotation * rest.rotation.conjugate()).conjugate();
  const Vector3d to(rest.translation.x(), start.translation.y(), rest.translation.z());
  const RigidTransform move{turn, to - turn * start.translation};
  for (Pose& pose : result.frames) {
    for (std::size_t j = 0; j < joints.size(); ++j) {
      if (joints[j].parent >= 0) continue;
      pose.rotations[j] = turn * pose.rotations[j];
      pose.translations[j] = move * pose.translations[j];
    }
  }
  return result;
}

Motion mirror(const Motion& motion) {
  std::map<std::string, std::size_t> by_name;
  for (std::size_t j = 0; j < motion.skeleton.size(); ++j)
    by_name.emplace(canonical_name(motion.skeleton.joints[j].name), j);
  std::vector<std::size_t> partner;
  for (const Joint& joint : motion.skeleton.joints) {
    const auto found = by_name.find(other_side(canonical_name(joint.name)));
    if (found == by_name.end())
      throw_invalid_argument("a motion can't be mirrored: joint '" + joint.name + "' has no partner on the other side");
    partner.push_back(found->second);
  }
  const auto flip = [](const Quaterniond& q) { return Quaterniond(q.w(), q.x(), -q.y(), -q.z()); };
  const auto rest = world_transforms(motion.skeleton, rest_pose(motion.skeleton));
  Motion result{motion.skeleton, motion.frame_time_s, {}};
  for (const Pose& pose : motion.frames) {
    const auto world = world_transforms(motion.skeleton, pose);
    std::vector<RigidTransform> mirrored(world.size());
    for (std::size_t j = 0; j < world.size(); ++j) {
      const std::size_t p = partner[j];
      mirrored[j].rotation = flip(world[p].rotation * rest[p].rotation.conjugate()) * rest[j].rotation;
      mirrored[j].translation = world[p].translation.cwiseProduct(Vector3d(-1, 1, 1));
    }
    result.frames.push_back(pose_from_world(motion.skeleton, mirrored));
  }
  return result;
}

std::vector<FastPlace> find_fast(const Motion& motion, const SpeedLimits& limits) {
  const std::size_t joints = motion.skeleton.size();
  std::vector<FastPlace> moving(joints), turning(joints);
  auto before = world_transforms(motion.skeleton, motion.frames.front());
  for (std::size_t k = 0; k + 1 < motion.frames.size(); ++k) {
    auto after = world_transforms(motion.skeleton, motion.frames[k + 1]);
    for (std::size_t j = 0; j < joints; ++j) {
      const double speed = (after[j].translation - before[j].translation).norm() / motion.frame_time_s;
      const double turn = degrees(motion.frames[k].rotations[j].angularDistance(motion.frames[k + 1].rotations[j]));
      if (speed > moving[j].speed) moving[j] = {k, motion.skeleton.joints[j].name, speed, false};
      if (turn / motion.frame_time_s > turning[j].speed)
        turning[j] = {k, motion.skeleton.joints[j].name, turn / motion.frame_time_s, true};
    }
    before = std::move(after);
  }
  const auto excess = [&limits](const FastPlace& place) {
    return place.speed / (place.turning ? limits.degrees_per_s : limits.metres_per_s);
  };
  std::vector<FastPlace> fast;
  for (const auto& places : {moving, turning})
    std::copy_if(places.begin(), places.end(), std::back_inserter(fast), [&](const auto& p) { return excess(p) > 1; });
  std::stable_sort(fast.begin(), fast.end(), [&](const auto& a, const auto& b) { return excess(a) > excess(b); });
  return fast;
}

std::string describe(const FastPlace& place, const SpeedLimits& limits) {
  std::array<char, 200> text{};
  std::snprintf(text.data(), text.size(), "frame %zu: %s %s at %.1f %s, above %g", place.frame, place.joint.c_str(),
                place.turning ? "turns" : "moves", place.speed, place.turning ? "degrees/s" : "m/s",
                place.turning ? limits.degrees_per_s : limits.metres_per_s);
  return text.data();
}

}  // namespace pleat::body
