#include "services/presentation/input/body_input.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxFastPlaces = 3;

body::MotionOptions motion_options(const v1::Body& message, double frame_time_s, const std::string& where) {
  body::MotionOptions options;
  options.frame_time_s = message.has_frame_time_s() ? message.frame_time_s() : frame_time_s;
  options.start_s = message.start_s();
  if (message.has_end_s()) options.end_s = message.end_s();
  if (message.has_ease_frames()) options.ease_frames = static_cast<int>(std::min(message.ease_frames(), 1u << 20));
  if (message.has_smoothing()) options.smoothing = static_cast<int>(std::min(message.smoothing(), 1u << 20));
  options.mirrored = message.mirrored();
  options.at_rest_place = !message.keep_place();
  try {
    body::validate_options(options);
  } catch (const Error& error) {
    throw Error(error.code(), where + ": " + error.what());
  }
  return options;
}

/// A file that the scene names: as it is, or from the scene's folder.
fs::path file_of(const std::string& name, const fs::path& folder, const std::string& where) {
  if (name.empty()) return {};
  const fs::path file = folder / name;
  std::error_code ignored;
  if (!fs::is_regular_file(file, ignored)) throw_not_found(where + " " + file.string() + ": no such file");
  return file;
}

}  // namespace

body::AnimatedBody inline_body(v1::Obstacle& obstacle, double frame_time_s, std::size_t most, const fs::path& folder,
                               const std::string& where, std::vector<std::string>& notes) {
  const v1::Body message = obstacle.body();
  if (obstacle.motion_size() > 0) throw_invalid_argument(where + " has key frames, a body moves by its motion_file");
  if (obstacle.has_animation()) throw_invalid_argument(where + " has an animation, a body moves by its motion_file");
  if (message.file().empty()) throw_invalid_argument(where + ".body.file is missing");
  const body::MotionOptions options = motion_options(message, frame_time_s, where + ".body");
  const body::AnimatedBody::Source source{file_of(message.file(), folder, where + ".body.file"),
                                          file_of(message.motion_file(), folder, where + ".body.motion_file"),
                                          file_of(message.skeleton_file(), folder, where + ".body.skeleton_file")};
  try {
    body::AnimatedBody animated(source, options,
                                message.skinning() == v1::Body::SKINNING_DUAL_QUATERNION
                                    ? body::Skinning::kDualQuaternion
                                    : body::Skinning::kLinear);
    for (const std::string& note : animated.notes()) notes.push_back("'" + obstacle.name() + "': " + note);
    const auto fast = body::find_fast(animated.motion());
    for (std::size_t i = 0; i < std::min(fast.size(), kMaxFastPlaces); ++i) {
      notes.push_back("'" + obstacle.name() + "': too fast for cloth: " + body::describe(fast[i], {}));
    }
    Topology mesh = animated.mesh().mesh;
    mesh.rest_positions = animated.positions(0);
    *obstacle.mutable_mesh() = to_message(mesh);
    const std::size_t samples = std::min(animated.frame_count(), most);
    if (samples < 2) return animated;
    obstacle.mutable_animation()->set_sample_time_s(options.frame_time_s);
    auto& positions = *obstacle.mutable_animation()->mutable_positions();
    positions.Reserve(static_cast<int>(samples * static_cast<std::size_t>(mesh.rest_positions.size())));
    for (std::size_t k = 0; k < samples; ++k) {
      const Positions sample = animated.positions(k);
      positions.Add(sample.data(), sample.data() + sample.size());
    }
    return animated;
  } catch (const Error& error) {
    throw Error(error.code(), where + ".body: " + error.what());
  }
}

}  // namespace pleat::presentation
