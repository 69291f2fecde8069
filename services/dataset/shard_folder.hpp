// Where the workers of a data set that many machines make keep what is not finished: FOLDER/shards, until it is merged.
//
// - shards/plan.json: what the set is to be; the first worker's, and equal to everybody's
// - shards/leases/NAME.G: who makes sequence NAME (common/base/lease.hpp); G is one more for each worker after another
// - shards/work/NAME.G/: what that worker writes: sequences/NAME.h5.partial, its check-point
// - dataset.h5: the master file, still without normalisation
// - sequences/NAME.h5: a finished sequence, renamed from shards/work/NAME.G
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "common/store/dataset.hpp"
#include "services/dataset/scenes.hpp"

namespace pleat::dataset {

std::filesystem::path shards_folder(const std::filesystem::path& folder);
std::filesystem::path leases_folder(const std::filesystem::path& folder);
std::filesystem::path work_folder(const std::filesystem::path& folder, const std::string& name,
                                  std::uint64_t generation);

/// Whether workers have begun the data set and it is not merged yet.
bool has_shards(const std::filesystem::path& folder);
/// Throws kFailedPrecondition if has_shards().
void require_no_shards(const std::filesystem::path& folder);

/// A sequence of the plan, as far as it is known without its scene.
struct ShardSequence {
  std::string name, split;
  std::uint64_t frames = 0;
  std::string scene_hash;
};

struct ShardPlan {
  std::vector<ShardSequence> sequences;  ///< in the set's order
  std::string topology_hash;             ///< of the fine mesh; where sequences have their own, of all coarse ones
  std::string material_hash;
  std::uint64_t seed = 0;
  bool tracked = true, deflate = true;
  std::string git_revision;  ///< of who began: not compared
};

ShardPlan make_shard_plan(const std::vector<SequencePlan>& plans, const DatasetMaster& master, bool deflate);

/// Leaves `plan` and `master`, with the plan's sequences, in the folder if nobody has before, and returns the plan that
/// is there. Any number of workers may begin at once. Throws kFailedPrecondition if it is another plan,
/// kResourceExhausted if it can't be written.
ShardPlan begin_shards(const std::filesystem::path& folder, const ShardPlan& plan, const DatasetMaster& master);

/// A folder of this process's own below a parent, removed at the end.
class OwnFolder {
 public:
  /// Throws kInvalidArgument if it can't be made.
  explicit OwnFolder(const std::filesystem::path& parent);
  ~OwnFolder();
  OwnFolder(const OwnFolder&) = delete;
  OwnFolder& operator=(const OwnFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// The plan of has_shards(). Throws kDataLoss if it can't be read.
ShardPlan read_shard_plan(const std::filesystem::path& folder);

/// Finished or dropped: nobody need make it.
bool is_settled(const std::filesystem::path& folder, const ShardSequence& sequence);
/// Dropped, when it was made of this very scene.
bool is_dropped(const std::filesystem::path& folder, const ShardSequence& sequence);

/// Gives `name` to the work folder of its new holder of `generation`: what the last holder left there, or a worker that
/// was no shard, is copied, never moved, because they may still write it. Complete copies alone are kept.
void inherit_work(const std::filesystem::path& folder, const std::string& name, std::uint64_t generation);

/// Puts what the holder of `generation` has made, finished or dropped, in its place. A sequence that somebody else has
/// put there meanwhile has the same bits. Removes the work folders of this and of earlier generations.
void publish_work(const std::filesystem::path& folder, const std::string& name, std::uint64_t generation);

}  // namespace pleat::dataset
