// The charts (islands) of a garment's material coordinates, as people lay them out, made ready for use.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// The chart of each face, numbered from 0 by first face: connected components of uv_faces. O(F).
std::vector<std::uint32_t> face_charts(const Topology& topology);

/// Turns over (u -> -u inside its extent) every chart all of whose faces are clockwise: the other half of a garment is
/// often the mirrored first one. Returns how many were turned.
std::size_t turn_mirrored_charts(Topology& topology);

/// Two faces that cover a common area in material space, of different charts or of one. Expects no face without area.
std::optional<std::pair<Eigen::Index, Eigen::Index>> find_overlap(const Topology& topology, bool of_one_chart);

/// Lays the charts side by side, a twentieth of the largest extent apart, if some overlap or lie more than three times
/// that from all others: only distances within a chart mean anything. Returns whether it did.
bool lay_out_charts(Topology& topology);

/// What reading a garment does: turns charts, lays them out, and then throws kInvalidArgument as
/// validate_material_coordinates, or if faces of one chart overlap. `notes` gets a line for each change.
void prepare_garment(Topology& topology, const std::string& name, std::vector<std::string>& notes);

}  // namespace pleat
