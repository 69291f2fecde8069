// Materials that lie between those that there are. Internal to this room.
#pragma once

#include <string>

#include "services/simulation/material.hpp"

namespace pleat::dataset {

/// `share` of the way from one material to another: figures that both are positive in by their logarithms, as stiffness
/// is felt, others linearly. Exactly the first one for a share of 0.
simulation::Material between(const simulation::Material& from, const simulation::Material& to, double share);

/// ARCSim's format, which parse_material reads back exactly.
std::string to_json(const simulation::Material& material);

}  // namespace pleat::dataset
