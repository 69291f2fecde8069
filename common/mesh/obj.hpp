// Wavefront OBJ with separate material coordinate indices.
#pragma once

#include <filesystem>
#include <iosfwd>
#include <string_view>

#include "common/base/limits.hpp"
#include "common/mesh/polygons.hpp"

namespace pleat {

/// Limits against hostile files.
struct ObjLimits {
  std::size_t max_vertices = kMaxVertices;
  std::size_t max_faces = kMaxFaces;
};

/// Reads `v`, `vt` and `f` (with v, v/vt, v/vt/vn, v//vn; negative indices are relative as the format says). A
/// backslash at the end of a line joins the next one, lines end with LF, CR LF or CR, and marks of byte order are
/// skipped. Polygons become triangles by triangulate(); corners that repeat the one before, or close the polygon, are
/// dropped. Statements that say nothing about the shape are ignored; what is no statement is an error. Throws kNotFound
/// (no file), kInvalidArgument (syntax, NaN, index out of range, a polygon that crosses itself, another encoding; with
/// file and line), kResourceExhausted (limits). The result passes validate_topology.
Topology read_obj(const std::filesystem::path& path, MeshUse use = MeshUse::kGarment, const ObjLimits& limits = {});
Topology read_obj(std::istream& stream, const std::string& name, MeshUse use = MeshUse::kGarment,
                  const ObjLimits& limits = {});

/// The vertices of a file whose polygons, in their order, have the corners of `rest`'s faces: a frame of that mesh.
/// Throws as read_obj, and kInvalidArgument for another topology; material coordinates are not looked at.
Positions read_obj_frame(const std::filesystem::path& path, const Topology& rest, const ObjLimits& limits = {});

/// The first line of what write_obj writes.
inline constexpr std::string_view kObjMark = "# written by Pleat, in metres";

/// Writes kObjMark, `comment` (whole lines that begin with #), positions (default: the rest positions), material
/// coordinates and faces with 9 significant digits, so that reading gives the same floats. Appears when it is complete
/// (WholeFile). Throws kResourceExhausted if the disk is full, kInvalidArgument if it can't be made.
void write_obj(const std::filesystem::path& path, const Topology& topology);
void write_obj(const std::filesystem::path& path, const Topology& topology, const Positions& positions,
               std::string_view comment = {});

}  // namespace pleat
