// A body and its motion as frames of a scene.
#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "services/simulation/body/character_file.hpp"

namespace pleat::body {

struct MotionOptions {
  double frame_time_s = kDefaultFrameTime;                 ///< of the result
  double start_s = 0;                                      ///< of the motion, what comes before is left out
  double end_s = std::numeric_limits<double>::infinity();  ///< of the motion, what comes after is left out
  int ease_frames = 15;  ///< from the rest pose into the motion ([DT-S] 15, [MFSR] 80)
  int smoothing = 1;     ///< rounds of smooth()
  bool mirrored = false;
  bool at_rest_place = true;  ///< start_at_rest(), and the lowest joint of all frames as high as the lowest at rest
};

/// Throws kInvalidArgument, naming the option and its range.
void validate_options(const MotionOptions& options);

/// The motion for the body, in this order: retarget (which leaves a motion of the same skeleton as it is), mirror,
/// resample, smooth, start_at_rest, ease_from_rest. Errors are those of these functions, and of
/// validate_options.
Motion fit_motion(const Motion& motion, const Skeleton& body, const MotionOptions& options,
                  const std::string& motion_name, const std::string& body_name, std::vector<std::string>& notes);

/// Reads a body and, where there is one, a motion for it, and fits it. An empty motion path takes the body file's own
/// animation if it has one; otherwise the body stays at rest, one frame.
class AnimatedBody {
 public:
  struct Source {
    std::filesystem::path body, motion, asf;
  };
  /// Throws as the readers and fit_motion do.
  AnimatedBody(const Source& source, const MotionOptions& options, Skinning skinning);

  const SkinnedMesh& mesh() const { return mesh_; }
  const Motion& motion() const { return motion_; }
  const std::vector<std::string>& notes() const { return notes_; }
  std::size_t frame_count() const { return motion_.frames.size(); }
  /// (V x 3) metres. The last frame stays.
  Positions positions(std::size_t frame) const;

 private:
  SkinnedMesh mesh_;
  Motion motion_;
  Skinning skinning_;
  std::vector<std::string> notes_;
};

}  // namespace pleat::body
