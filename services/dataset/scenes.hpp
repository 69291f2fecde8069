// The scenes of the built-in data sets ([MFSR] section 6), and their JSON.
#pragma once

#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "services/simulation/scene.hpp"

namespace pleat::dataset {

/// A character and its motion, as pleat.v1.Body has them.
struct BodyMotion {
  std::filesystem::path body, motion;
  double start_s = 0, end_s = std::numeric_limits<double>::infinity();  ///< of the motion
  int ease_frames = 0;                                                  ///< from the rest pose into the motion
  bool mirrored = false;
};

/// Of each obstacle of a scene the samples of its animation, or none.
using SceneSamples = std::vector<std::vector<Positions>>;

/// A sequence to be: its scene, and the split that it belongs to.
struct SequencePlan {
  std::string name;
  std::string split;  ///< "train" or "test"
  simulation::Scene scene;
  std::optional<BodyMotion> body;  ///< the scene's only obstacle, which has no shape before put_body (dressed_sets.hpp)
  /// Of one's own scenes: what the scene's animations have besides their first samples. Shared by a scene's variations.
  std::shared_ptr<const SceneSamples> samples;
  bool tracked = true;
  bool own_meshes = false;    ///< its garment is not that of the other sequences
  std::string material_json;  ///< ARCSim-format text, of one's own scenes and of family; empty: SceneOptions::material
  std::string scene_json;     ///< the same as pleat.v1.Scene in protobuf's JSON form
};

/// How large a set is unless told otherwise.
struct SetSize {
  int train = 10, test = 3;  ///< sequences of each split
  int frames = 150;          ///< per sequence
};
/// The papers' size ([MFSR] section 6, [DT-S]), or the same sequences cut short. draping: 10 + 3 sequences of 400
/// frames; hitting: 27 + 8 of 1,000; sheet: 16 + 4 of 200; disk: 8 + 2 of 200; skirt: 5 + 2, tshirt and pants: 18 + 2,
/// at most 1,000 frames of each motion; family: 96 + 12 of 120. Small: 150 frames each, or 60 (sheet, disk, family).
SetSize set_size(const std::string& set, bool full);

/// SHEET and DISK of [DT-S]: their fine cloth is a simulation of its own, unless told otherwise.
bool is_free_set(const std::string& set);

/// skirt, tshirt and pants: garments on a body that moves.
bool is_dressed_set(const std::string& set);

/// A garment, a material and a scene of its own for each sequence.
inline constexpr const char* kFamily = "family";

/// What a set is made of unless told otherwise. Paths are below deploy/; family has neither garment nor material.
struct SetDefaults {
  std::string garment, material;
  int rounds = simulation::Scene().subdivision_rounds;
  bool tracked = true;
};
/// `rounds` of edge splitting, 0: the set's own. [DT-S] table 3 compares coarse meshes for one fine one: SHEET's has
/// 8,192 faces, and its garment follows from the rounds (2: 512 faces, 3: 128, 4: 32).
SetDefaults set_defaults(const std::string& set, int rounds = 0);

/// The set of the user's own scenes.
inline constexpr const char* kOwnScenes = "scenes";

struct SceneOptions {
  std::string set = "draping";  ///< draping, hitting, sheet, disk, skirt, tshirt, pants, family; scenes: own_scenes
  int train = 10;               ///< sequences for training
  int test = 3;                 ///< sequences for testing
  int extra = 0;                ///< further sequences for training, behind the others, which stay as they are
  int frames = 150;             ///< per sequence, the initial state included
  int rounds = 0;               ///< of edge splitting: 2, 3, 4 make 16, 64, 256 fine faces of one; 0: the set's
  std::uint64_t seed = 1;
  bool tracked = true;             ///< the fine cloth follows the coarse one; false: free fine simulations ([DT-S])
  bool springs = false;            ///< tracked as [MFSR] section 4.2 has it, instead of by averages
  double frequency = 0;            ///< rad/s, of averages; 0: the set's
  std::filesystem::path garment;   ///< OBJ or PLY with material coordinates
  double garment_scale = 1;        ///< metres per unit of the file
  std::filesystem::path material;  ///< ARCSim-format JSON
  std::vector<std::filesystem::path> materials;   ///< set "family": those between which its materials lie
  std::filesystem::path body;                     ///< dressed sets: a rigged character that wears the garment at rest
  std::vector<std::filesystem::path> motions;     ///< dressed sets: BVH and AMC files, and folders of them
  std::vector<std::filesystem::path> own_scenes;  ///< set "scenes": scene files, which say all but what is below
  int sequences = 12;                             ///< set "scenes": variations
};

/// How the fine cloth of a plan follows the coarse one: by averages, by springs, or, if it is not tracked, not at all.
/// Throws kInvalidArgument for a frequency without averages.
void set_tracking(const SceneOptions& options, SequencePlan& plan);

/// DRAPING: one vertex of the cloth's upper edge is held; the cloth starts tilted by a random rotation, falls and
/// swings. No two sequences hold the same vertex; further ones hold the others, then those of the training split again.
/// HITTING: two corners of the upper edge are held, and a sphere swings through the hanging cloth; one of its five
/// sizes and three of its eight places are in the test split only, in turn. SHEET and DISK: flat_sets.hpp. SKIRT,
/// TSHIRT and PANTS: dressed_sets.hpp; FAMILY: family_set.hpp; one's own scenes: scene_set.hpp. Dressed sets may have
/// fewer sequences than was asked for. Deterministic for a seed. Throws kInvalidArgument (unknown set, counts), and
/// what reading the files throws. `notes`, if given, gets a line for what was changed in the garment or is unusual
/// about it (read_garment), and for what was left out.
std::vector<SequencePlan> plan_sequences(const SceneOptions& options, std::vector<std::string>* notes = nullptr);

/// "SET-07": the name of sequence `number`.
std::string numbered(const std::string& set, std::size_t number);

/// The scene of a built-in set as a file beside deploy/scenes/*.json would have it. Only what plan_sequences sets. Of a
/// plan with its own meshes it names no garment: that is in the sequence's file.
std::string scene_to_json(const SequencePlan& plan, const std::filesystem::path& garment,
                          const std::filesystem::path& material);

}  // namespace pleat::dataset
