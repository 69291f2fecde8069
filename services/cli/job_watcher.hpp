// Follows a job on a coordinator from a thread of its own, so that the main thread can listen to Ctrl-C.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "common/base/error.hpp"
#include "common/rpc/channel.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::cli {

/// Called in the watcher's thread; what they throw ends the watching, and wait() throws it.
struct JobSinks {
  std::function<void(const v1::JobOpened&)> opened;     ///< may come again after a lost connection
  std::function<void(const v1::EnhancedFrame&)> frame;  ///< in order, each index once
  std::function<void(const v1::FrameError&)> frame_error;
  bool wants_frames() const { return static_cast<bool>(frame); }
};

/// Connects again while the coordinator is away, for `patience` at most, and goes on with the frame after the last.
class JobWatcher {
 public:
  JobWatcher(std::shared_ptr<grpc::Channel> channel, std::string address, std::string job_id, JobSinks sinks,
             std::chrono::seconds patience = std::chrono::seconds(30));
  /// Stops watching; the job goes on.
  ~JobWatcher();

  /// Waits for `timeout` at most. The job as last heard of, and whether watching is over.
  /// Throws what ended the watching: an error of a sink, kUnavailable (the coordinator stayed away), kNotFound.
  std::pair<v1::Job, bool> wait(std::chrono::milliseconds timeout);

 private:
  void run();
  /// One stream. True: the job has ended and everything was sent.
  bool watch_once();

  std::unique_ptr<v1::Coordinator::Stub> stub_;
  std::string address_, job_id_;
  JobSinks sinks_;
  std::chrono::seconds patience_;
  std::mutex mutex_;
  std::condition_variable changed_;
  grpc::ClientContext* context_ = nullptr;  ///< of the running call
  v1::Job job_;
  bool over_ = false, stopping_ = false;
  std::optional<Error> error_;
  std::uint64_t next_index_ = 0;
  std::chrono::steady_clock::time_point last_heard_;
  std::thread thread_;
};

/// queued, running, ... for people.
std::string state_name(v1::Job::State state);
bool has_ended(v1::Job::State state);

}  // namespace pleat::cli
