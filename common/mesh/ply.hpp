// Stanford PLY: text, binary of either byte order.
#pragma once

#include <filesystem>

#include "common/mesh/polygons.hpp"

namespace pleat {

/// Elements `vertex` (x, y, z; s, t or u, v or texture_u, texture_v become material coordinates) and `face`
/// (vertex_indices or vertex_index); other elements and properties are skipped. Throws kNotFound, kInvalidArgument (not
/// PLY, no such properties, values that are not finite), kDataLoss (truncated), kResourceExhausted (limits as of OBJ).
PolygonMesh read_ply(const std::filesystem::path& path);

}  // namespace pleat
