// From scenes of one's own to a bundle: data, training and evaluation, one after the other, within a time.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "services/evaluation/evaluation.hpp"

namespace pleat::cli {

struct LearnOptions {
  std::vector<std::string> scenes;  ///< files
  std::filesystem::path out;        ///< the bundle, NAME.pt; NAME.html beside it is the page
  std::string base;            ///< bundle to begin with; empty: `any` where it is shipped, else fresh weights; "none"
  std::filesystem::path work;  ///< everything that it needs to go on; empty: OUT without its extension, and ".learn"
  double minutes = 20;         ///< data, training and evaluation together
  int sequences = 0;           ///< variations of the scenes; 0: 12, or fewer so that the time suffices
  int frames = 0;              ///< of each sequence; 0: the scenes', at most 100, or fewer so that the time suffices
  int workers = 0;             ///< processes that simulate; 0: one a processor
  std::uint64_t seed = 1;
};

struct LearnResult {
  std::filesystem::path bundle, page;
  std::vector<evaluation::MethodFigures> figures;  ///< the learned bundle last
  std::string verdict;                             ///< one line
};

/// How the time is divided, and what it suffices for.
struct LearnBudget {
  int sequences = 0, frames = 0;
  double data_minutes = 0;  ///< estimated
};

/// sequences, frames: at most; frames come down to 30 first, then sequences to 6, until the data take 30 % of `minutes`
/// at most. fixed_*: those that may not come down. scenes: sequences besides. seconds: of a frame on one thread.
LearnBudget plan_budget(double minutes, int scenes, LearnBudget wanted, bool fixed_sequences, bool fixed_frames,
                        double seconds, int workers);

/// Does what is not done yet, with progress on stderr. From the main thread, before others exist. Everything is in the
/// work folder, which is known by its learn.json; files of others there and in the way of `out` stay and are errors.
/// Throws kInvalidArgument, kNotFound (scenes, base), kAlreadyExists, kFailedPrecondition (the folder was begun with
/// other scenes or options), kCancelled after Ctrl-C; the cause of a child's end.
LearnResult learn(const LearnOptions& options);

}  // namespace pleat::cli
