#include "services/dataset/shards.hpp"

#include <algorithm>
#include <charconv>
#include <map>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/lease.hpp"
#include "common/base/parallel.hpp"
#include "common/base/whole_file.hpp"
#include "services/dataset/normalization.hpp"
#include "services/dataset/sequence.hpp"
#include "services/dataset/shard_folder.hpp"
#include "services/dataset/workers.hpp"

namespace pleat::dataset {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

/// How long the processes may take to their check-points after a signal: batch systems kill after 10 s or more.
constexpr std::chrono::seconds kGrace{9};
/// How often signals and other workers are looked for.
constexpr milliseconds kLook{250};

int whole_number(const std::string& text, const std::string& name) {
  int value = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (failed != std::errc() || end != text.data() + text.size() || text.empty()) {
    throw_invalid_argument(name + ": '" + text + "' is not a whole number");
  }
  return value;
}

Shard parse_flag(const std::string& flag) {
  const std::size_t slash = flag.find('/');
  if (slash == std::string::npos) throw_invalid_argument("--shard: '" + flag + "' is not I/N or none");
  Shard shard{whole_number(flag.substr(0, slash), "--shard"), whole_number(flag.substr(slash + 1), "--shard"),
              "--shard"};
  if (shard.count < 1 || shard.index < 1 || shard.index > shard.count) {
    throw_invalid_argument("--shard: '" + flag + "': I is from 1 to N");
  }
  return shard;
}

/// The tasks of an array that is not MIN, MIN + STEP, ... share places: leases keep them apart.
Shard from_slurm(int id, int count, int first, int step) {
  if (count < 1 || step < 1 || id < first) {
    throw_invalid_argument("SLURM_ARRAY_TASK_ID: task " + std::to_string(id) + " of " + std::to_string(count) +
                           " from " + std::to_string(first) + " is none");
  }
  return {(id - first) / step % count + 1, count, "SLURM_ARRAY_TASK_ID"};
}

Shard from_kubernetes(int index, int count) {
  if (index < 0 || count < 1 || index >= count) {
    throw_invalid_argument("JOB_COMPLETION_INDEX: " + std::to_string(index) +
                           " of JOB_COMPLETIONS=" + std::to_string(count) + " is none");
  }
  return {index + 1, count, "JOB_COMPLETION_INDEX"};
}

/// What one process of a shard does: the sequence of its lease, in the lease's folder, published when it is done.
SequenceReport make_leased(const GenerateOptions& options, const SequencePlan& plan, std::uint64_t generation,
                           const std::function<void(std::uint64_t)>& on_frame, const std::function<bool()>& stopped) {
  inherit_work(options.folder, plan.name, generation);
  const SequenceReport report = make_sequence(work_folder(options.folder, plan.name, generation), plan, options.deflate,
                                              on_frame, {.stopped = stopped, .durable = true});
  if (!report.interrupted) publish_work(options.folder, plan.name, generation);
  return report;
}

class ShardWorker {
 public:
  ShardWorker(const GenerateOptions& options, const ShardOptions& shard,
              const std::function<void(const Progress&)>& progress)
      : options_(options),
        shard_(shard),
        progress_(progress),
        plans_(plan_sequences(options.scenes, &notes_)),
        pool_(WorkerPool::Signals::kIgnored) {
    const DatasetMaster master = make_master(options_, plans_);
    inspect_folder(options_, plans_, master);
    plan_ = make_shard_plan(plans_, master, options_.deflate);
    frames_.assign(plans_.size(), 0);
    failed_.assign(plans_.size(), 0);
    if (is_merged()) return;
    const ShardPlan begun = begin_shards(options_.folder, plan_, master);
    if (begun.git_revision != plan_.git_revision) {
      notes_.push_back("the data set was begun by revision '" + begun.git_revision + "', this is '" +
                       plan_.git_revision + "'");
    }
    leases_.emplace(leases_folder(options_.folder), shard_.expiry);
    choose_order();
    choose_processes();
  }

  ShardEnd run() {
    for (const std::string& note : notes_) report("note: " + note);
    const Shard& shard = shard_.shard;
    report("shard " + std::to_string(shard.index) + " of " + std::to_string(shard.count) + " (" + shard.source + ")");
    while (true) {
      if (shard_.interrupted && shard_.interrupted()) return stop();
      start_what_is_free();
      if (pool_.size() == 0) {
        if (failure_) throw *failure_;
        if (unsettled_.empty()) return ShardEnd::kDone;
        if (others_live()) return ShardEnd::kOthersWork;
      }
      wait();
    }
  }

 private:
  /// The set as it was asked for is there already.
  bool is_merged() const {
    std::error_code ignored;
    if (has_shards(options_.folder) || !std::filesystem::exists(options_.folder / "dataset.h5", ignored)) return false;
    const DatasetReader reader(options_.folder);
    return reader.master().normalization.has_value() &&
           std::all_of(plan_.sequences.begin(), plan_.sequences.end(),
                       [&](const ShardSequence& sequence) { return is_settled(options_.folder, sequence); });
  }

  /// Our own share, then the others' from there on, so that helpers do not all meet at the same sequence.
  void choose_order() {
    const auto count = static_cast<std::size_t>(shard_.shard.count);
    for (std::size_t turn = 0; turn < count; ++turn) {
      const std::size_t share = (static_cast<std::size_t>(shard_.shard.index - 1) + turn) % count;
      for (std::size_t i = share; i < plans_.size(); i += count) unsettled_.push_back(i);
    }
    forget_settled();
  }

  void choose_processes() {
    const std::size_t processors = available_processors();
    const std::size_t most = options_.workers > 0 ? static_cast<std::size_t>(options_.workers) : processors;
    const auto count = static_cast<std::size_t>(shard_.shard.count);
    const std::size_t share = (unsettled_.size() + count - 1) / count;
    processes_ = std::max<std::size_t>(1, std::min(most, share));
    for (SequencePlan& plan : plans_) {
      plan.scene.threads = static_cast<int>(std::max<std::size_t>(1, processors / processes_));
    }
  }

  void forget_settled() {
    std::erase_if(unsettled_, [&](std::size_t i) {
      if (!is_settled(options_.folder, plan_.sequences[i])) return false;
      frames_[i] = is_finished(options_.folder, plans_[i].name) ? plan_.sequences[i].frames : 0;
      return true;
    });
  }

  void report(const std::string& message) {
    Progress now;
    for (std::size_t i = 0; i < plans_.size(); ++i) {
      now.frames_done += frames_[i];
      now.frames += plan_.sequences[i].frames;
    }
    now.elapsed_s = std::chrono::duration<double>(Clock::now() - start_).count();
    now.message = message;
    progress_(now);
  }

  void start_what_is_free() {
    if (pool_.size() >= processes_ || Clock::now() < next_look_) return;
    next_look_ = Clock::now() + std::min<milliseconds>(shard_.expiry / 4, std::chrono::seconds(5));
    forget_settled();
    for (const std::size_t i : unsettled_) {
      if (pool_.size() >= processes_) return;
      if (failed_[i] != 0 || held_.count(i) > 0) continue;
      std::optional<Lease> lease = leases_->claim(plans_[i].name);
      if (!lease) continue;
      if (is_settled(options_.folder, plan_.sequences[i])) {  // while we claimed it
        lease->release();
        continue;
      }
      start(i, std::move(*lease));
    }
  }

  void start(std::size_t i, Lease lease) {
    const SequencePlan& plan = plans_[i];
    const std::uint64_t generation = lease.generation();
    held_.emplace(i, std::move(lease));
    pool_.start(i, [&](const auto& on_frame, const auto& stopped) {
      return make_leased(options_, plan, generation, on_frame, stopped);
    });
    report(plan.name + " (" + plan.split + ") begins, holder " + std::to_string(generation));
  }

  /// Whether all who hold what is left have been seen alive.
  bool others_live() const {
    return std::all_of(unsettled_.begin(), unsettled_.end(), [&](std::size_t i) {
      return failed_[i] != 0 || leases_->holder(plans_[i].name) == Holder::kAlive;
    });
  }

  void wait() {
    pool_.wait(kLook, [this](const WorkerEvent& event) { take(event); });
    if (Clock::now() < next_renewal_) return;
    next_renewal_ = Clock::now() + shard_.expiry / 4;
    for (auto entry = held_.begin(); entry != held_.end();) {
      auto& [i, lease] = *entry;
      if (lease.renew()) {
        ++entry;
        continue;
      }
      pool_.kill(i);
      report(plans_[i].name + " was taken over by another worker: this one was silent for too long");
      entry = held_.erase(entry);
    }
  }

  void take(const WorkerEvent& event) {
    if (event.kind == WorkerEvent::Kind::kFrame) {
      frames_[event.plan] = event.frames;
      return report("");
    }
    next_look_ = {};
    const auto lease = held_.find(event.plan);
    const bool lost = lease == held_.end() || !lease->second.renew();
    if (lease != held_.end()) {
      lease->second.release();
      held_.erase(lease);
    }
    // The folder of who lost its lease may have been taken away from it.
    if (event.error && (lost || is_settled(options_.folder, plan_.sequences[event.plan]))) return;
    report(plans_[event.plan].name + how_it_ended(event));
    if (!event.error) return;
    failed_[event.plan] = 1;
    if (!failure_) failure_.emplace(event.error->code(), plans_[event.plan].name + ": " + event.text);
  }

  ShardEnd stop() {
    pool_.stop();
    const auto last = Clock::now() + kGrace;
    while (pool_.size() > 0 && Clock::now() < last) wait();
    // A frame that takes longer is made again after the last check-point.
    std::vector<std::size_t> late;
    for (const auto& [i, lease] : held_) late.push_back(i);
    for (const std::size_t i : late) {
      pool_.kill(i);
      held_.at(i).release();
    }
    return ShardEnd::kInterrupted;
  }

  const GenerateOptions& options_;
  const ShardOptions& shard_;
  const std::function<void(const Progress&)>& progress_;
  const Clock::time_point start_ = Clock::now();
  std::vector<std::string> notes_;
  std::vector<SequencePlan> plans_;
  ShardPlan plan_;
  std::vector<std::size_t> unsettled_;  ///< in the order in which we would make them
  std::vector<std::uint64_t> frames_;   ///< known to be made
  std::vector<char> failed_;
  std::size_t processes_ = 1;
  std::optional<LeaseFolder> leases_;
  std::map<std::size_t, Lease> held_;
  Clock::time_point next_look_, next_renewal_;
  std::optional<Error> failure_;
  WorkerPool pool_;  // last: what it runs must not outlive the rest
};

/// The sequences of the plan that are kept. Adds to `missing` those that are neither made nor dropped.
std::vector<std::string> kept_sequences(const std::filesystem::path& folder, const ShardPlan& plan,
                                        std::vector<std::string>& missing) {
  std::vector<std::string> kept;
  for (const ShardSequence& sequence : plan.sequences) {
    if (is_finished(folder, sequence.name)) {
      kept.push_back(sequence.name);
    } else if (!is_dropped(folder, sequence)) {
      missing.push_back(sequence.name);
    }
  }
  return kept;
}

void require_finished(const DatasetReader& reader) {
  for (const std::string& name : reader.master().sequences) {
    if (!is_finished(reader.folder(), name)) {
      throw Error(ErrorCode::kFailedPrecondition, reader.folder().string() + ": sequence " + name +
                                                      " is not finished and no shards make it: run the command that "
                                                      "began the data set");
    }
  }
}

/// Written beside the folder's own master file, which is there for readers until it is replaced.
void write_master(const std::filesystem::path& folder, DatasetMaster master, double margin) {
  const OwnFolder own(shards_folder(folder));
  std::filesystem::create_directory_symlink(std::filesystem::absolute(folder / "sequences"), own.path() / "sequences");
  master.normalization.reset();
  write_dataset_master(own.path(), master);
  master.normalization = measure_range(DatasetReader(own.path()), margin);
  write_dataset_master(own.path(), master);
  publish_file(own.path() / "dataset.h5", folder / "dataset.h5");
}

}  // namespace

std::optional<Shard> choose_shard(const std::string& flag, const std::function<const char*(const char*)>& variable) {
  if (flag == "none") return std::nullopt;
  if (!flag.empty()) return parse_flag(flag);
  const auto number = [&](const char* name, std::optional<int> missing = std::nullopt) {
    const char* value = variable(name);
    if (value == nullptr && missing) return *missing;
    if (value == nullptr) throw_invalid_argument(std::string(name) + " is not set; give --shard I/N or --shard none");
    return whole_number(value, name);
  };
  if (variable("SLURM_ARRAY_TASK_ID") != nullptr) {
    return from_slurm(number("SLURM_ARRAY_TASK_ID"), number("SLURM_ARRAY_TASK_COUNT"),
                      number("SLURM_ARRAY_TASK_MIN", 0), number("SLURM_ARRAY_TASK_STEP", 1));
  }
  if (variable("JOB_COMPLETION_INDEX") != nullptr) {
    return from_kubernetes(number("JOB_COMPLETION_INDEX"), number("JOB_COMPLETIONS"));
  }
  return std::nullopt;
}

ShardEnd generate_shard(const GenerateOptions& options, const ShardOptions& shard,
                        const std::function<void(const Progress&)>& progress) {
  return ShardWorker(options, shard, progress).run();
}

ShardEnd merge(const std::filesystem::path& folder, double margin,
               const std::function<void(const std::string&)>& line) {
  DatasetMaster master = DatasetReader(folder).master();
  if (!has_shards(folder)) {
    require_finished(DatasetReader(folder));
    line("no shards to merge" + std::string(master.normalization ? "" : "; measuring the normalisation"));
    if (!master.normalization) write_master(folder, std::move(master), margin);
  } else {
    std::vector<std::string> missing;
    master.sequences = kept_sequences(folder, read_shard_plan(folder), missing);
    if (!missing.empty()) {
      line(std::to_string(missing.size()) + " sequences are not made yet, the first: " + missing.front());
      return ShardEnd::kOthersWork;
    }
    line(std::to_string(master.sequences.size()) + " sequences; measuring the normalisation of the training split");
    write_master(folder, std::move(master), margin);
  }
  std::error_code ignored;
  std::filesystem::remove_all(shards_folder(folder), ignored);
  return ShardEnd::kDone;
}

}  // namespace pleat::dataset
