// Where a cloth is held and how it is turned: shared by the sets of this room. Internal.
#pragma once

#include <cstdint>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::dataset {

inline constexpr double kDegree = 0.017453292519943295;  ///< radians

/// Boundary vertices within a hundredth of the cloth's size of its upper edge (the smallest z of the flat rest shape,
/// which becomes the top when the cloth is tilted about x), ordered along x.
std::vector<std::uint32_t> upper_edge(const Topology& cloth);

/// First `pitch` about x (the upper edge rises), then `roll` about z and `yaw` about y: axis times angle.
Eigen::Vector3d tilt(double pitch_deg, double roll_deg, double yaw_deg);

}  // namespace pleat::dataset
