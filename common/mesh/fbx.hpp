// FBX as a mesh with frames.
#pragma once

#include <filesystem>
#include <memory>

#include "common/mesh/animated_mesh.hpp"

namespace pleat {

/// FILE.fbx through assimp: all meshes, joined, in the file's unit and axes; blend shapes and nodes that move, of the
/// first animation. Corners that are one point in every frame are one vertex. What a skeleton moves is refused, and
/// caches in files of their own are not part of it. Errors as open_animated_mesh; in a build without assimp
/// kInvalidArgument.
std::unique_ptr<AnimatedMesh> open_fbx(const std::filesystem::path& path);

}  // namespace pleat
