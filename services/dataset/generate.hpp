// Makes paired data sets: one process per sequence, resumable, with progress.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "common/store/dataset.hpp"
#include "services/dataset/scenes.hpp"
#include "services/dataset/workers.hpp"

namespace pleat::dataset {

struct Progress {
  std::uint64_t frames_done = 0;  ///< over all sequences, those of earlier runs included
  std::uint64_t frames = 0;
  double elapsed_s = 0;
  double left_s = 0;         ///< estimated from this run's speed; 0 until a frame is done
  std::string message = {};  ///< a line for people: a note on the garment, a sequence that begins or ends
};

struct GenerateOptions {
  std::filesystem::path folder;
  SceneOptions scenes;
  int workers = 0;       ///< processes; 0: the processors this process may use
  bool deflate = true;   ///< compress finished sequences
  double margin = 0.02;  ///< the normalisation's range is wider than the training split by this share on each side
  std::string git_revision;
};

/// The master file of these plans, without sequences and normalisation.
DatasetMaster make_master(const GenerateOptions& options, const std::vector<SequencePlan>& plans);

/// Throws kFailedPrecondition if the folder holds another data set. Returns the frames that are complete per sequence.
std::map<std::string, std::uint64_t> inspect_folder(const GenerateOptions& options,
                                                    const std::vector<SequencePlan>& plans,
                                                    const DatasetMaster& master);

/// " is finished: ...", after the name of the sequence.
std::string how_it_ended(const WorkerEvent& event);

/// Makes what is missing of the data set, then writes its master file. Frames that exist are kept; a data set that was
/// begun with other scenes, or that shards make, is refused with kFailedPrecondition. Forks: call it before other
/// threads exist. If sequences fail, the others are made all the same and the first failure is thrown. Dressed
/// sequences that are dropped (sequence.hpp) are not in the master file, and are not tried again.
void generate(const GenerateOptions& options, const std::function<void(const Progress&)>& progress);

}  // namespace pleat::dataset
