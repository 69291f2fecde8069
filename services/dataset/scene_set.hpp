// Sequences made of scenes of one's own, and of variations of them (docs/datasets.md). Internal to this room.
#pragma once

#include <string>
#include <vector>

#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

/// First each of options.own_scenes as it is, for testing; then options.sequences variations, of the scenes in turn,
/// every sixth of them (the last one, if there are fewer) for testing. Garment, handles, wind, obstacles and bodies
/// stay what they are; what is varied is in the table of docs/datasets.md. A sequence follows from its scene, its
/// number and the seed alone: a larger set contains the smaller one, but for the split of a last one that had to be for
/// testing. All scenes have one garment, frame time and subdivision. `notes` gets what is unusual, a line each. Throws
/// kInvalidArgument, naming the scene (garments that differ, a start that is not clean, names that are taken), and what
/// reading the files throws; kInvalidArgument in a build without gRPC, which reads no scene files.
std::vector<SequencePlan> plan_own_scenes(const SceneOptions& options, std::vector<std::string>& notes);

}  // namespace pleat::dataset
