// Characters and motions from the files of other tools: glTF/GLB, FBX, Collada and BVH through assimp.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "services/simulation/body/motion.hpp"
#include "services/simulation/body/skinned_mesh.hpp"

namespace pleat::body {

/// What a file holds, in metres with Y up.
struct CharacterFile {
  std::optional<SkinnedMesh> body;  ///< all skinned meshes as one, absent if the file has no mesh
  std::vector<Motion> motions;      ///< one for each animation, sampled; of the body's skeleton if there is one
  std::vector<std::string>
      notes;  ///< for people, one line each: units and axes that were recognised, what was left out
};

/// Reads a file. The rest pose is the bind pose; scales of nodes are applied, so that joints are rigid; the four
/// strongest weights of a vertex stay; corners that differ in normals or texture only are one vertex again.
/// Units and axes: what the format says (glTF: metres, Y up; Collada: in the file), and a body of the hundredfold
/// size of a person is in centimetres; a figure whose head is above its hips along Z is turned. Notes say which.
/// A motion keeps its file's rate of keys, and has at least 30 frames a second.
/// Throws kNotFound, kInvalidArgument (not of a known format; a mesh that has no skeleton or vertices without weights;
/// a skeleton or motion that validate_skeleton or validate_motion refuse; a body that fits neither metres nor
/// centimetres), kResourceExhausted (above 512 MiB). The file is named.
CharacterFile read_character_file(const std::filesystem::path& path);

/// The motion of a file: its first animation; for NAME.amc, of the skeleton in `asf` or NAME.asf or the only ASF beside
/// it. Throws kInvalidArgument if there is none.
Motion read_motion(const std::filesystem::path& path, std::vector<std::string>& notes,
                   const std::filesystem::path& asf = {});

}  // namespace pleat::body
