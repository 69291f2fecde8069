// The set FAMILY: garments of many shapes, each in a scene of its own. Internal to this room.
#pragma once

#include <vector>

#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

/// A sequence for each garment: cloth that hangs, drops onto things, is hit, blown, twisted, shaken or worn, of a
/// material between two of options.materials, with steps, damping and friction of its own. What a sequence is follows
/// from its number and the seed alone, so that a larger set contains a smaller one; kinds of garments and of motions
/// take turns. Throws kInvalidArgument (counts, frames), and what reading the materials throws.
std::vector<SequencePlan> plan_family(const SceneOptions& options);

}  // namespace pleat::dataset
