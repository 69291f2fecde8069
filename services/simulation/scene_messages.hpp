// Scene messages -> scenes.
#pragma once

#include "pleat/v1/scene.pb.h"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// Fills in the contract's defaults and validates. The message carries the garment's mesh and the material's JSON:
/// file names are refused, because they mean files of the client. Throws kInvalidArgument with the culprit.
Scene scene_from_message(const v1::Scene& message);

}  // namespace pleat::simulation
