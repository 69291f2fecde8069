#include "services/simulation/body/animated_body.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/base/error.hpp"
#include "services/simulation/body/retarget.hpp"

namespace pleat::body {
namespace {

double lowest_joint(const Skeleton& skeleton, const Pose& pose) {
  double lowest = std::numeric_limits<double>::infinity();
  for (const RigidTransform& joint : world_transforms(skeleton, pose)) lowest = std::min(lowest, joint.translation.y());
  return lowest;
}

/// Lifts or lowers the whole motion: its lowest joint of all frames is as high as the lowest at rest.
Motion on_the_floor(Motion motion) {
  double lowest = std::numeric_limits<double>::infinity();
  for (const Pose& pose : motion.frames) lowest = std::min(lowest, lowest_joint(motion.skeleton, pose));
  const double lift = lowest_joint(motion.skeleton, rest_pose(motion.skeleton)) - lowest;
  for (Pose& pose : motion.frames)
    for (std::size_t j = 0; j < motion.skeleton.size(); ++j)
      if (motion.skeleton.joints[j].parent < 0) pose.translations[j].y() += lift;
  return motion;
}

}  // namespace

void validate_options(const MotionOptions& options) {
  constexpr int kMaxEaseFrames = 10'000, kMaxSmoothing = 100;
  const auto check = [](bool good, const char* text) {
    if (!good) throw_invalid_argument(text);
  };
  check(options.frame_time_s > 0 && std::isfinite(options.frame_time_s), "the time between frames must be positive");
  check(options.start_s >= 0 && std::isfinite(options.start_s), "the start of the motion must not be negative");
  check(options.end_s > options.start_s, "the end of the motion must be after its start");
  check(options.ease_frames >= 0 && options.ease_frames <= kMaxEaseFrames,
        "the frames into the motion must be 0 to 10000");
  check(options.smoothing >= 0 && options.smoothing <= kMaxSmoothing, "the rounds of smoothing must be 0 to 100");
}

Motion fit_motion(const Motion& motion, const Skeleton& body, const MotionOptions& options,
                  const std::string& motion_name, const std::string& body_name, std::vector<std::string>& notes) {
  validate_options(options);
  validate_motion(motion, motion_name);
  Retargeted fitted = retarget(motion, body, motion_name, body_name);
  notes.insert(notes.end(), fitted.notes.begin(), fitted.notes.end());
  Motion result = options.mirrored ? mirror(fitted.motion) : std::move(fitted.motion);
  result = smooth(resample(result, options.frame_time_s, options.start_s, options.end_s), options.smoothing);
  if (options.at_rest_place) result = on_the_floor(start_at_rest(result));
  return ease_from_rest(result, options.ease_frames);
}

AnimatedBody::AnimatedBody(const Source& source, const MotionOptions& options, Skinning skinning)
    : skinning_(skinning) {
  CharacterFile file = read_character_file(source.body);
  if (!file.body)
    throw_invalid_argument(source.body.string() + ": a skeleton without a mesh; a body needs a skinned mesh");
  notes_ = file.notes;
  mesh_ = std::move(*file.body);
  motion_ = {mesh_.skeleton, options.frame_time_s, {rest_pose(mesh_.skeleton)}};
  if (source.motion.empty() && file.motions.empty()) return;
  const std::filesystem::path& from = source.motion.empty() ? source.body : source.motion;
  const Motion motion =
      source.motion.empty() ? std::move(file.motions.front()) : read_motion(source.motion, notes_, source.asf);
  motion_ = fit_motion(motion, mesh_.skeleton, options, from.string(), source.body.string(), notes_);
}

Positions AnimatedBody::positions(std::size_t frame) const {
  const Pose& pose = motion_.frames[std::min(frame, motion_.frames.size() - 1)];
  return skin(mesh_, world_transforms(mesh_.skeleton, pose), skinning_);
}

}  // namespace pleat::body
