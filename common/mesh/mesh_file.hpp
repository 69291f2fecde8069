// Meshes of any format that we read, chosen by the file's ending.
#pragma once

#include <filesystem>

#include "common/mesh/polygons.hpp"

namespace pleat {

/// Whether files of this name are read by read_mesh: .obj, .ply.
bool is_mesh_file(const std::filesystem::path& path);

/// Throws as read_obj and read_ply, kInvalidArgument for another ending.
Topology read_mesh(const std::filesystem::path& path, MeshUse use);

/// A frame of `rest` (to_frame).
Positions read_mesh_frame(const std::filesystem::path& path, const Topology& rest);

/// ".obj" of "A.OBJ".
std::string lower_extension(const std::filesystem::path& path);

}  // namespace pleat
