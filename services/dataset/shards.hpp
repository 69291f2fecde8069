// A data set made by many workers on machines that share its folder, and put together at the end.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "services/dataset/generate.hpp"

namespace pleat::dataset {

/// Which sequences a worker begins with. That is all it means: who makes a sequence is decided by its lease.
struct Shard {
  int index = 1, count = 1;  ///< 1 <= index <= count
  std::string source;        ///< where that was said, for people
};

/// What `flag` says, "I/N" or "none"; if it is empty, what the environment does: SLURM_ARRAY_TASK_ID with _COUNT, _MIN
/// and _STEP, then JOB_COMPLETION_INDEX with JOB_COMPLETIONS. Nothing: no shard. `variable` gives a variable's value,
/// or null, as std::getenv. Throws kInvalidArgument, naming the culprit.
std::optional<Shard> choose_shard(const std::string& flag, const std::function<const char*(const char*)>& variable);

struct ShardOptions {
  Shard shard;
  std::chrono::milliseconds expiry = std::chrono::minutes(1);  ///< a worker that is silent for so long has died
  std::function<bool()> interrupted = {};                      ///< asked several times a second
};

enum class ShardEnd {
  kDone,         ///< all sequences are made; merge() comes next
  kOthersWork,   ///< other workers, which are alive, still make some; this one had nothing left to do
  kInterrupted,  ///< what this worker was making is at a check-point
};

/// Works on the set until nothing is left that nobody else makes: first this shard's share, then, as a helper, whatever
/// no other worker holds or a dead one has left. Any number of workers may do so at any time, with the same options
/// otherwise; any of them may be killed: the sequences have the bits that generate() makes. Forks. Throws what
/// generate() throws; a sequence that failed here is not tried again by this worker.
ShardEnd generate_shard(const GenerateOptions& options, const ShardOptions& shard,
                        const std::function<void(const Progress&)>& progress);

/// Makes the master file, with the normalisation (widened by `margin`, as generate() does), when all sequences are
/// made, and removes what workers left. Several at once make the same one. `line` gets what is said to people.
/// kOthersWork: there are sequences that are not made. Throws kFailedPrecondition without shards if the folder's
/// sequences are not finished, kNotFound without a data set.
ShardEnd merge(const std::filesystem::path& folder, double margin, const std::function<void(const std::string&)>& line);

}  // namespace pleat::dataset
