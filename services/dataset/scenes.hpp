// The scenes of the built-in data sets ([MFSR] section 6), and their JSON.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "services/simulation/scene.hpp"

namespace pleat::dataset {

/// A sequence to be: its scene, and the split that it belongs to.
struct SequencePlan {
  std::string name;
  std::string split;  ///< "train" or "test"
  simulation::Scene scene;
  bool tracked = true;
  std::string scene_json;  ///< the same as pleat.v1.Scene in protobuf's JSON form
};

/// How large a set is unless told otherwise.
struct SetSize {
  int train = 10, test = 3;  ///< sequences of each split
  int frames = 150;          ///< per sequence
};
/// The papers' size ([MFSR] section 6, [DT-S]), or the same sequences cut short. draping: 10 + 3 sequences of 400
/// frames; hitting: 27 + 8 of 1,000; sheet: 16 + 4 of 200; disk: 8 + 2 of 200. Small: 150 frames each, or 60.
SetSize set_size(const std::string& set, bool full);

/// The sets of [DT-S]: their fine cloth is always a simulation of its own.
bool is_free_set(const std::string& set);

/// Below deploy/: the garment that a set is made for.
std::string default_garment(const std::string& set);

struct SceneOptions {
  std::string set = "draping";  ///< draping, hitting, sheet or disk
  int train = 10;               ///< sequences for training
  int test = 3;                 ///< sequences for testing
  int extra = 0;                ///< further sequences for training, behind the others, which stay as they are
  int frames = 150;             ///< per sequence, the initial state included
  int rounds = 0;               ///< of edge splitting: 2, 3, 4 make 16, 64, 256 fine faces of one; 0: 2
  std::uint64_t seed = 1;
  bool tracked = true;             ///< the fine cloth follows the coarse one; false, and always false for sheet and
                                   ///< disk: free fine simulations ([DT-S])
  bool springs = false;            ///< tracked as [MFSR] section 4.2 has it, instead of by averages
  std::filesystem::path garment;   ///< OBJ or PLY with material coordinates
  double garment_scale = 1;        ///< metres per unit of the file
  std::filesystem::path material;  ///< ARCSim-format JSON
};

/// DRAPING: one vertex of the cloth's upper edge is held; the cloth starts tilted by a random rotation, falls and
/// swings. No two sequences hold the same vertex; further ones hold the others, then those of the training split again.
/// HITTING: two corners of the upper edge are held, and a sphere swings through the hanging cloth; one of its five
/// sizes and three of its eight places are in the test split only, in turn. SHEET and DISK: flat_sets.hpp.
/// Deterministic for a seed. Throws kInvalidArgument (unknown set, counts), and what reading the files throws.
/// `notes`, if given, gets a line for what was changed in the garment or is unusual about it (read_garment).
std::vector<SequencePlan> plan_sequences(const SceneOptions& options, std::vector<std::string>* notes = nullptr);

/// The scene as a file beside deploy/scenes/*.json would have it. Only what plan_sequences sets.
std::string scene_to_json(const simulation::Scene& scene, const std::filesystem::path& garment,
                          const std::filesystem::path& material);

}  // namespace pleat::dataset
