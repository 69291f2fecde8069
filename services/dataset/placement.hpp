// Where a cloth is held and how it is turned: shared by the sets of this room. Internal.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::dataset {

inline constexpr double kDegree = 0.017453292519943295;  ///< radians

/// Whether the garment is modelled as it hangs (y up) and not lying flat.
bool is_upright(const Topology& cloth);

/// The vertices that hold a cloth, along its upper rim. Of one that lies flat: boundary vertices within a hundredth of
/// its size of its smallest z, which becomes the top when it is tilted about x, along x. Of one that is upright: the
/// highest vertices that lie on a boundary, within a hundredth of its height, else all within that of its top.
std::vector<std::uint32_t> upper_edge(const Topology& cloth);

/// Further vertices of an upper edge that has fewer than `count`: those next to the top.
void add_next_highest(const Topology& cloth, std::size_t count, std::vector<std::uint32_t>& edge);

/// Why the cloth can't start like this; empty: it can. Throws what Simulation throws, kInvalidArgument excepted.
std::string fault_of_start(const simulation::Scene& scene);

/// First `pitch` about x (the upper edge rises), then `roll` about z and `yaw` about y: axis times angle.
Eigen::Vector3d tilt(double pitch_deg, double roll_deg, double yaw_deg);

}  // namespace pleat::dataset
