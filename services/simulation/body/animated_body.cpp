#include "services/simulation/body/animated_body.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "services/simulation/body/retarget.hpp"

namespace pleat::body {

Motion fit_motion(const Motion& motion, const Skeleton& body, const MotionOptions& options,
                  const std::string& motion_name, const std::string& body_name, std::vector<std::string>& notes) {
  validate_motion(motion, motion_name);
  Retargeted fitted = retarget(motion, body, motion_name, body_name);
  notes.insert(notes.end(), fitted.notes.begin(), fitted.notes.end());
  Motion result = options.mirrored ? mirror(fitted.motion) : std::move(fitted.motion);
  result = smooth(resample(result, options.frame_time_s, options.start_s), options.smoothing);
  if (options.at_rest_place) result = start_at_rest(result);
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
