// One sequence of a data set, simulated and recorded; continues where an earlier process stopped.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/store/dataset.hpp"
#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

/// The figures of what was simulated, for people.
struct SequenceReport {
  double coarse_ms = 0;  ///< mean per frame
  double fine_ms = 0;    ///< mean per frame
  std::uint64_t cut_steps = 0;
  std::string dropped = {};  ///< why the sequence is no good and was not kept; empty: it was
  bool interrupted = false;  ///< it was asked to stop, and did, with a check-point
};

struct SequenceControl {
  std::function<bool()> stopped = {};  ///< asked after every frame
  /// Frames count once they are synced, which is done at every check-point: a machine that goes, with what it has not
  /// written yet, takes none that counts with it. Later ones of an earlier process are made anew.
  bool durable = false;
};

/// What is simulated.
MeshPair meshes_of(const SequencePlan& plan);

/// FOLDER/sequences/NAME.h5, and what lies beside it while it is made, or instead of it when it was dropped.
std::filesystem::path sequence_file(const std::filesystem::path& folder, const std::string& name);
std::filesystem::path partial_file(const std::filesystem::path& folder, const std::string& name);
std::filesystem::path checkpoint_file(const std::filesystem::path& folder, const std::string& name);
std::filesystem::path dropped_file(const std::filesystem::path& folder, const std::string& name);

/// True if FOLDER/sequences/NAME.h5 is finished.
bool is_finished(const std::filesystem::path& folder, const std::string& name);

/// Why the sequence was dropped when it was made of this very scene; nothing if it was not.
std::optional<std::string> why_dropped(const std::filesystem::path& folder, const SequencePlan& plan);

/// The JSON of the scene that a dropped sequence was made of; nothing if it was not dropped.
std::optional<std::string> dropped_scene(const std::filesystem::path& folder, const std::string& name);

/// Name and reason of all dropped sequences of a folder, by name.
std::vector<std::pair<std::string, std::string>> dropped_sequences(const std::filesystem::path& folder);

/// Leaves word that the sequence is dropped, in FOLDER/sequences/NAME.dropped, and removes what there is of it.
void drop_sequence(const std::filesystem::path& folder, const SequencePlan& plan, const std::string& reason);

/// Seconds that a frame of the sequence takes on one thread, coarse and fine: of its first `frames`, or of as many as
/// fit into `seconds`. Throws what Simulation throws.
double seconds_per_frame(const SequencePlan& plan, int frames, double seconds);

/// Simulates the coarse and the tracked fine cloth and records every frame. A check-point beside the file every 20
/// frames lets a killed process continue with the same bits. `on_frame` gets the number of complete frames. A dressed
/// sequence that WornJudge finds fault with is dropped.
SequenceReport make_sequence(const std::filesystem::path& folder, const SequencePlan& plan, bool deflate,
                             const std::function<void(std::uint64_t)>& on_frame, const SequenceControl& control = {});

}  // namespace pleat::dataset
