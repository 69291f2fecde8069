// Rigged characters and their motions as obstacles of a scene.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "pleat/v1/scene.pb.h"
#include "services/simulation/body/animated_body.hpp"

namespace pleat::presentation {

/// Puts a mesh and an animation of at most `most` samples in the place of `obstacle.body()`; its paths start at
/// `folder`. frame_time_s: the scene's, which the body's stands back for. notes get what the readers noticed, and where
/// the motion is too fast for cloth. Throws as body::AnimatedBody does, and kInvalidArgument for options out of range
/// or key frames and another animation beside the body; `where` goes before messages. Returns what the samples were
/// made of.
body::AnimatedBody inline_body(v1::Obstacle& obstacle, double frame_time_s, std::size_t most,
                               const std::filesystem::path& folder, const std::string& where,
                               std::vector<std::string>& notes);

}  // namespace pleat::presentation
