// Relaxes a start that is not clean.
#pragma once

#include "common/base/parallel.hpp"
#include "services/simulation/contact.hpp"

namespace pleat::simulation {

/// Moves the cloth among `positions` (all particles) until contact.violations() is empty, or progress ends. Returns
/// whether it is. Obstacles stay. What has crossed goes back to the side of the larger part, what is inside an obstacle
/// goes out; the rest of the cloth follows smoothly. Meant for starts that are almost clean: layers that cross a
/// little, a garment that dips into a body. Deterministic.
bool untangle(ContactSystem& contact, Points& positions, ThreadPool& pool);

}  // namespace pleat::simulation
