// Follows a job on a coordinator from a thread of its own, through lost connections.
#pragma once

#include <grpcpp/channel.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/client/cpp/values.hpp"
#include "pleat/v1/coordinator.pb.h"

namespace pleat::client {

struct CallMetadata;

/// What a job's frames refer to.
struct JobMeshes {
  Mesh coarse, fine;
  std::vector<ObstacleShape> obstacles;
};

/// Called in the watcher's thread; what they throw ends the watching, and wait() throws it.
struct JobSinks {
  std::function<void(const JobMeshes&)> opened;     ///< before the first frame; may come again after a lost connection
  std::function<void(const EnhancedFrame&)> frame;  ///< in order, each index once, those with an error too
  bool wants_frames() const { return static_cast<bool>(frame); }
};

struct JobWatchOptions {
  std::uint64_t from_index = 0;       ///< the first frame wanted
  std::chrono::seconds patience{30};  ///< how long the coordinator may stay away
};

/// What is known of a job.
struct JobProgress {
  v1::Job job;        ///< as last heard of; without an id before the first message
  bool over = false;  ///< the job has ended and everything was sent
};

/// Connects again while the coordinator is away, and goes on with the frame after the last.
class JobWatcher {
 public:
  JobWatcher(JobWatcher&&) noexcept;
  JobWatcher& operator=(JobWatcher&&) noexcept;
  /// Stops watching; the job goes on.
  ~JobWatcher();

  /// Waits for `timeout` at most, or until it is over. Throws what ended the watching: an error of a sink,
  /// kUnavailable (the coordinator stayed away), kNotFound (no such job).
  JobProgress wait(std::chrono::milliseconds timeout) const;

 private:
  friend class Client;
  struct State;
  JobWatcher(const std::shared_ptr<grpc::Channel>& channel, std::string peer, const CallMetadata& metadata,
             std::string job_id, JobSinks sinks, const JobWatchOptions& options);
  std::unique_ptr<State> state_;
};

/// queued, running, ... for people.
std::string state_name(v1::Job::State state);
/// Done, failed or cancelled.
bool has_ended(v1::Job::State state);

}  // namespace pleat::client
