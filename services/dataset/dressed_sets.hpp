// The sets SKIRT ([MFSR]), TSHIRT and PANTS ([DT-S]): garments on a body that dances. Internal to this room.
#pragma once

#include <string>
#include <vector>

#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

/// What the scenes of a dressed set are besides garment, material and size: a body, a motion for it and friction. Reads
/// the motions, leaves out what PoseJudge finds fault with, cuts the stretches of at least a second between that into
/// pieces of at most options.frames frames (the way from the rest pose into the motion included), and takes as many
/// pieces as are wanted: the first ones of all clips, then the second ones, ..., then their mirror images; the clips in
/// an order that follows from the seed. Pieces of 55_02 and 05_04 are in the test split, and no mirror images of them
/// ([MFSR] section 7); those of all others in the training split. `notes` gets a line for what is left out, and one for
/// a split that is smaller than wanted. Throws kInvalidArgument (frames, body, motions) and what reading the files
/// throws; kInvalidArgument in a build without assimp, as put_body does.
std::vector<SequencePlan> plan_dressed(const SceneOptions& options, const Topology& cloth,
                                       std::vector<std::string>& notes);

/// Puts the body, skinned in every frame, into the scene.
void put_body(simulation::Scene& scene, const BodyMotion& body);

}  // namespace pleat::dataset
