// One sequence of a data set, simulated and recorded; continues where an earlier process stopped.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

/// The figures of what was simulated, for people.
struct SequenceReport {
  double coarse_ms = 0;  ///< mean per frame
  double fine_ms = 0;    ///< mean per frame
  std::uint64_t cut_steps = 0;
};

/// True if FOLDER/sequences/NAME.h5 is finished.
bool is_finished(const std::filesystem::path& folder, const std::string& name);

/// Simulates the coarse and the tracked fine cloth and records every frame. A check-point beside the file every 20
/// frames lets a killed process continue with the same bits. `on_frame` gets the number of complete frames.
SequenceReport make_sequence(const std::filesystem::path& folder, const SequencePlan& plan, bool deflate,
                             const std::function<void(std::uint64_t)>& on_frame);

}  // namespace pleat::dataset
