// Garments from files, checked before anything is made of them.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// read_mesh, then prepare_garment. scale: metres per unit of the file; material coordinates are taken along if they
/// are in the same unit. `notes` gets a line for each change and for an unusual size. Throws as both.
Topology read_garment(const std::filesystem::path& path, std::vector<std::string>& notes, double scale = 1);

/// The same of a mesh that was read already; `name` goes before messages.
Topology made_garment(Topology garment, const std::string& name, std::vector<std::string>& notes, double scale = 1);

/// Several garments as one mesh of as many pieces: vertices and faces of the first, then of the next; the material
/// coordinates of every one lie beside those before it, at larger u. Throws std::out_of_range if there are none.
Topology join_garments(const std::vector<Topology>& garments);

/// Lengths of edges over others of the same edges.
struct EdgeRatios {
  double median = 1, most = 1;
};
EdgeRatios edge_ratios(const Positions& now, const Positions& rest, const Faces& faces);
/// In space over in material coordinates, where both have a length.
EdgeRatios material_ratios(const Topology& garment);

/// What simulates the garment takes its rest lengths from the material coordinates. Throws kInvalidArgument if edges
/// are on the median more than twice or less than half as long in space.
void require_rest_lengths(const Topology& garment, const std::string& name);

/// Throws kInvalidArgument if `frame` can't be a frame of `rest` although it has as many vertices: edges that are on
/// the median more than twice or less than half as long as at rest, or one that is ten times as long.
void require_frame_of(const Positions& frame, const Topology& rest, const std::string& frame_name,
                      const std::string& rest_name);

}  // namespace pleat
