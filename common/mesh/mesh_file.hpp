// Meshes of any format that we read, chosen by the file's ending.
#pragma once

#include <filesystem>

#include "common/mesh/polygons.hpp"

namespace pleat {

/// Whether files of this name are read by read_mesh: .obj, .ply, and those of open_animated_mesh.
bool is_mesh_file(const std::filesystem::path& path);

/// Of a file with frames the first one. Throws as read_obj, read_ply and open_animated_mesh, kInvalidArgument for
/// another ending.
Topology read_mesh(const std::filesystem::path& path, MeshUse use);

/// A frame of `rest` (to_frame, MatchedFrames).
Positions read_mesh_frame(const std::filesystem::path& path, const Topology& rest);

/// ".obj" of "A.OBJ".
std::string lower_extension(const std::filesystem::path& path);

}  // namespace pleat
