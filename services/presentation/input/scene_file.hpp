// Scene files: pleat.v1.Scene in protobuf's JSON form, made ready for the wire.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "pleat/v1/scene.pb.h"

namespace pleat::body {
class AnimatedBody;
}

namespace pleat::presentation {

/// A body of a scene that is skinned linearly, a frame of its motion for each frame of the scene.
struct SceneBody {
  std::string obstacle;  ///< its name
  std::shared_ptr<const body::AnimatedBody> body;
};

struct SceneReading {
  std::uint32_t frames = 0;                   ///< instead of the scene's number; 0: the scene's
  double scale = 1;                           ///< metres per unit of the garment's file
  std::vector<std::string>* notes = nullptr;  ///< gets what was changed or is unusual, a line each
  std::vector<SceneBody>* bodies = nullptr;   ///< gets the bodies whose points the message has
};

/// Reads a scene file and puts the files that it names (garments, material, meshes, animations, bodies and their
/// motions; paths relative to the scene file) into the message, so that it can go to a service. Checks what needs no
/// simulation: unknown keys, handles on vertices that do not exist, steps, frames and frame time that are not positive,
/// vectors of another length than 3, names, radii, key frames out of order. Throws kNotFound (a file is missing),
/// kInvalidArgument (everything else), with the file and the key in one line.
///
/// Garments are read by read_garment and must have their rest lengths; obstacles that are not closed get lids
/// (close_holes); of animations and motions only the samples that the frames need are read. The message may be larger
/// than the wire takes in one piece (take_animations).
v1::Scene read_scene_file(const std::filesystem::path& path, const SceneReading& reading = {});

/// The same from text. `name` goes before messages, `folder` is where relative paths start.
v1::Scene parse_scene(const std::string& json, const std::string& name, const std::filesystem::path& folder,
                      const SceneReading& reading = {});

}  // namespace pleat::presentation
