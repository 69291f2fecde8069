// A mesh as files hold it: polygons of any number of corners. Readers of every format make one of these.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// What a mesh is read for.
enum class MeshUse {
  kGarment,   ///< with material coordinates where the file has them; all corners or none must
  kObstacle,  ///< without them
};

struct PolygonMesh {
  static constexpr std::uint32_t kNoUv = 0xffffffffu;
  struct Corner {
    std::uint32_t vertex = 0;
    std::uint32_t uv = kNoUv;
  };
  std::vector<float> positions;       ///< x, y, z of each vertex
  std::vector<float> uv;              ///< u, v of each material coordinate
  std::vector<Corner> corners;        ///< of all polygons, one behind the other; indices may be out of range
  std::vector<std::size_t> ends;      ///< one behind the last corner of each polygon, at least three corners each
  std::vector<std::uint32_t> places;  ///< of each polygon, for messages: "NAME:PLACE"
  std::string without_uv;             ///< where the first corner without material coordinates is, "" if all have them
};

/// Faces as scene formats list them: how many corners each face has, then the vertices of all corners.
struct FaceList {
  std::string file, mesh;  ///< names for messages
  std::span<const std::uint32_t> sizes, vertices;
  std::size_t vertex_count = 0;                    ///< that `vertices` may name
  std::span<const float> uv = {};                  ///< u, v of each material coordinate; empty: there are none
  std::span<const std::uint32_t> uv_indices = {};  ///< into uv, of each corner or vertex; empty: they come in order
  bool uv_by_vertex = false;                       ///< else each corner has its own
  bool clockwise = false;
};

/// Appends the faces; their vertex 0 is vertex `first` of the mesh. Corners that repeat the one before are dropped.
/// Throws kInvalidArgument (counts that do not belong together, indices out of range), kResourceExhausted.
void append_faces(PolygonMesh& mesh, const FaceList& faces, std::size_t first);

/// Three corners for each of the triangles that the polygons are cut into (triangulate). Throws kInvalidArgument for a
/// polygon that crosses itself or names a vertex that is not there; those of triangles are not looked at.
std::vector<PolygonMesh::Corner> triangle_corners(const PolygonMesh& mesh, const std::string& name);

/// Polygons as triangles, checked by validate_topology. Material coordinates that a vertex has several
/// times are one. Throws kInvalidArgument; NAME is named.
Topology to_topology(PolygonMesh mesh, const std::string& name, MeshUse use);

/// The vertices, where the polygons in their order have the corners of `rest`'s faces: a frame of that mesh. Throws
/// kInvalidArgument for another topology.
Positions to_frame(const PolygonMesh& mesh, const Topology& rest, const std::string& name);

}  // namespace pleat
