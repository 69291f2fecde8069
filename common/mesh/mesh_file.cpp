#include "common/mesh/mesh_file.hpp"

#include <cctype>

#include "common/base/error.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/obj.hpp"
#include "common/mesh/ply.hpp"

namespace pleat {
namespace {

[[noreturn]] void refuse(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored)) throw_not_found(path.string() + ": no such file");
  throw_invalid_argument(path.string() + ": meshes are read from .obj, .ply, .gltf, .glb, .fbx, .abc and .usda");
}

}  // namespace

std::string lower_extension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return extension;
}

bool is_mesh_file(const std::filesystem::path& path) {
  const std::string extension = lower_extension(path);
  return extension == ".obj" || extension == ".ply" || is_animated_mesh_file(path);
}

Topology read_mesh(const std::filesystem::path& path, MeshUse use) {
  const std::string extension = lower_extension(path);
  if (extension == ".obj") return read_obj(path, use);
  if (extension == ".ply") return to_topology(read_ply(path), path.string(), use);
  if (is_animated_mesh_file(path)) return to_topology(open_animated_mesh(path)->mesh(), path.string(), use);
  refuse(path);
}

Positions read_mesh_frame(const std::filesystem::path& path, const Topology& rest) {
  const std::string extension = lower_extension(path);
  if (extension == ".obj") return read_obj_frame(path, rest);
  if (extension == ".ply") return to_frame(read_ply(path), rest, path.string());
  if (is_animated_mesh_file(path)) return MatchedFrames(path, rest).positions(0);
  refuse(path);
}

}  // namespace pleat
