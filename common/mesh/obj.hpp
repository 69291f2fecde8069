// Wavefront OBJ with separate material coordinate indices.
#pragma once

#include <filesystem>
#include <iosfwd>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// Limits against hostile files.
struct ObjLimits {
  std::size_t max_vertices = 4'000'000;
  std::size_t max_faces = 8'000'000;
};

/// Reads `v`, `vt` and `f` (with v, v/vt, v/vt/vn, v//vn; negative indices are relative as the format says).
/// Polygons are triangulated as fans. Other statements are ignored. If only some corners carry `vt`: error.
/// Throws kNotFound (no file), kInvalidArgument (syntax, NaN, index out of range; with file and line),
/// kResourceExhausted (limits). The result passes validate_topology.
Topology read_obj(const std::filesystem::path& path, const ObjLimits& limits = {});
Topology read_obj(std::istream& stream, const std::string& name, const ObjLimits& limits = {});

/// Writes positions (default: the rest positions), material coordinates and faces with 9 significant digits, so that
/// reading gives the same floats. Throws kResourceExhausted if the disk is full, kInvalidArgument if it can't be
/// opened.
void write_obj(const std::filesystem::path& path, const Topology& topology);
void write_obj(const std::filesystem::path& path, const Topology& topology, const Positions& positions);

}  // namespace pleat
