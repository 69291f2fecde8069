// Works jobs off: simulation, pipeline, result file, and the reference simulation after it.
#pragma once

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "common/base/limits.hpp"
#include "pleat/v1/coordinator.pb.h"
#include "services/coordinator/active_job.hpp"
#include "services/coordinator/job_table.hpp"
#include "services/coordinator/pipeline.hpp"
#include "services/coordinator/simulation_source.hpp"

namespace pleat::coordinator {

struct JobSettings {
  std::size_t concurrency = 2;                          ///< jobs at the same time; others are queued
  std::size_t max_queued = 1000;                        ///< jobs that wait
  std::uint32_t window = 4;                             ///< frames in flight per stage and replica
  std::uint32_t checkpoint_interval = 25;               ///< frames between check-points of the simulation
  std::uint32_t max_frames = kMaxFrames;                ///< of one job
  bool compress = true;                                 ///< the finished result file
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the fine mesh of a job
  std::size_t max_jobs_each = 0;                        ///< of one owner that have not ended; 0: no limit
  double max_gb_each = 0;                               ///< of one owner's jobs on disk, 10^9 bytes; 0: no limit
  double keep_days = 0;                                 ///< jobs that have ended longer ago are removed; 0: never
  bool yield = true;                                    ///< where processors are short, live sessions have them first
};

/// Takes up unfinished jobs of the table at once. Thread-safe.
class JobRunner {
 public:
  JobRunner(JobTable& table, ServiceAddresses addresses, LinkOptions link, JobSettings settings);
  /// stop().
  ~JobRunner();

  /// Checks the request (the scene by opening it in the simulation service, the bundle by asking for it) and queues it.
  /// Errors: kInvalidArgument and kNotFound from the services, kFailedPrecondition (bundle of another mesh),
  /// kUnavailable naming the service's address, kResourceExhausted (a limit of the settings, or of the disk: a job
  /// whose file won't fit beside those of the jobs before it does not begin). trace: what all work on the job belongs
  /// to, now and after a restart; empty: a new one.
  JobRecord create(v1::CreateJobRequest request, const std::string& owner, const telemetry::TraceContext& trace = {});

  /// Ends the job, if it has not ended, and waits for that (at most 5 s).
  JobRecord cancel(const std::string& id);

  /// 1: the next; 0: it does not wait.
  std::uint32_t queue_place(const std::string& id) const;
  /// Whether create() would refuse every job for its queue.
  bool full() const;

  /// Null if the job is not being worked on.
  std::shared_ptr<ActiveJob> active(const std::string& id) const;

  /// Interrupts all jobs; they stay unfinished in the table and go on when a runner is made for it again.
  void stop();
  bool stopping() const;

 private:
  void require_room(const std::string& owner) const;
  void admit_bytes(const std::string& owner, const std::string& scene, std::uint64_t bytes) const;
  void sweep();
  void show_queue() const;
  void work();
  void execute(ActiveJob& job);
  void enhance(ActiveJob& job, const v1::CreateJobRequest& request, const Animations& animations,
               const LinkOptions& link);
  void simulate_reference(ActiveJob& job, const v1::CreateJobRequest& request, const Animations& animations,
                          const LinkOptions& link);
  LinkOptions link_for(const telemetry::TraceContext& trace) const;

  JobTable& table_;
  const ServiceAddresses addresses_;
  const LinkOptions link_;
  const JobSettings settings_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::string> queue_;
  std::map<std::string, std::shared_ptr<ActiveJob>> active_;
  bool stopping_ = false;
  std::vector<std::thread> workers_;
  std::thread sweeper_;
};

/// The file where the job's frames are: complete, partial, or nothing yet.
std::optional<std::filesystem::path> result_file(const std::filesystem::path& job_folder);

/// A check-point of a simulation in a file, with the index of the frame that it was made after, and what the fold step
/// and the network left there (null where they are not in use or remember nothing, or did not make the frame).
struct Checkpoint {
  std::uint64_t index = 0;
  std::string state;
  std::shared_ptr<const FoldMemory> fold = {};
  std::shared_ptr<const NetworkMemory> network = {};
};
void save_checkpoint(const std::filesystem::path& path, const Checkpoint& checkpoint);
/// Nothing if there is no usable one.
std::optional<Checkpoint> load_checkpoint(const std::filesystem::path& path);

}  // namespace pleat::coordinator
