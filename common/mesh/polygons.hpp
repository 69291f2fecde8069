// A mesh as files hold it: polygons of any number of corners. Readers of every format make one of these.
#pragma once

#include <cstdint>
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

/// Polygons as triangles (triangulate), checked by validate_topology. Throws kInvalidArgument; NAME is named.
Topology to_topology(PolygonMesh mesh, const std::string& name, MeshUse use);

/// The vertices, where the polygons in their order have the corners of `rest`'s faces: a frame of that mesh. Throws
/// kInvalidArgument for another topology.
Positions to_frame(const PolygonMesh& mesh, const Topology& rest, const std::string& name);

}  // namespace pleat
