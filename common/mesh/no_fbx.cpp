// In the place of fbx.cpp in a build without assimp.
#include "common/base/error.hpp"
#include "common/mesh/fbx.hpp"

namespace pleat {

std::unique_ptr<AnimatedMesh> open_fbx(const std::filesystem::path& path) {
  throw_invalid_argument(path.string() + ": this build reads no FBX, it was made without assimp");
}

}  // namespace pleat
