// Motions of a skeleton: frames at a constant rate, and what is done to them before a body follows them.
#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "services/simulation/body/skeleton.hpp"

namespace pleat::body {

/// Frame k is at k frame_time_s.
struct Motion {
  Skeleton skeleton;
  double frame_time_s = 1.0 / 120;
  std::vector<Pose> frames;

  double duration_s() const { return frames.empty() ? 0 : frame_time_s * static_cast<double>(frames.size() - 1); }
};

/// Throws kInvalidArgument, naming frame and joint: no frames, frames of another size, values that are not finite, a
/// rotation without length, a frame time that is not positive. kResourceExhausted above 20 million joint poses.
void validate_motion(const Motion& motion, const std::string& source);

/// Between two poses: rotations on the shortest arc (slerp), translations linearly. fraction 0 gives `a`.
Pose interpolate(const Pose& a, const Pose& b, double fraction);

/// The motion at a time, constant before its first and after its last frame.
Pose pose_at(const Motion& motion, double time_s);

/// The same motion from start_s to end_s with another frame time; the last frame is the last that is not after the end.
/// Throws kInvalidArgument if the start is after the end, or the frame time is not positive.
Motion resample(const Motion& motion, double frame_time_s, double start_s = 0,
                double end_s = std::numeric_limits<double>::infinity());

/// `rounds` times the binomial filter (1 4 6 4 1) / 16 over the frames: on joint quaternions, brought to one hemisphere
/// and normalised again, and on translations. The ends are repeated, so a constant motion stays.
Motion smooth(const Motion& motion, int rounds);

/// Puts `frames` frames in front that lead from the rest pose into the motion's first: interpolate() with the fraction
/// 10 u^3 - 15 u^4 + 6 u^5, which starts and ends at rest. Frame 0 is the rest pose; 0 frames: the motion as it is.
Motion ease_from_rest(const Motion& motion, int frames);

/// Turns about Y and moves horizontally, so that in the first frame the hips (the first joint, where none has that
/// name) are above the place and have the heading that they have at rest: a garment that fits at rest fits where the
/// motion starts.
Motion start_at_rest(const Motion& motion);

/// The mirror image at the plane x = 0 of a motion of a skeleton whose left and right joints mirror each other at rest
/// (names by canonical_name). Throws kInvalidArgument if a joint has no partner.
Motion mirror(const Motion& motion);

/// What cloth can follow: a dancer's hand reaches about 6 m/s.
struct SpeedLimits {
  double metres_per_s = 10;      ///< of a joint, in the world
  double degrees_per_s = 1'200;  ///< of a joint relative to its parent
};

/// Where a joint is faster than a limit.
struct FastPlace {
  std::size_t frame = 0;  ///< between this frame and the next
  std::string joint;
  double speed = 0;      ///< in the limit's unit
  bool turning = false;  ///< degrees a second instead of metres a second
};

/// The fastest place of each joint that breaks a limit, fastest (relative to its limit) first. O(frames x joints).
std::vector<FastPlace> find_fast(const Motion& motion, const SpeedLimits& limits = {});

/// "frame 12: LeftHand moves at 14.2 m/s, above 10".
std::string describe(const FastPlace& place, const SpeedLimits& limits);

}  // namespace pleat::body
