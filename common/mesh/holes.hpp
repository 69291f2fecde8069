// Obstacles that are not closed: bodies with an open neck, a ground of one quad.
#pragma once

#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// Makes the mesh closed. Every hole gets a lid of triangles between its own vertices. A mesh that encloses nothing
/// then (a sheet) becomes a slab instead: it is doubled a twentieth of its extent, 5 cm at least, behind itself (below,
/// if it lies flat), which needs new vertices; with keep_vertices (an animation names them) it is left as it is. So is
/// a mesh with edges of three faces. Faces of a closed mesh that look inwards are turned over. `notes` gets a line if
/// something was done. O(F log F).
Topology close_holes(Topology mesh, bool keep_vertices, const std::string& name, std::vector<std::string>& notes);

}  // namespace pleat
