#include "common/client/cpp/job_watcher.hpp"

#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>

#include "common/client/cpp/call_metadata.hpp"
#include "common/client/cpp/messages.hpp"
#include "common/rpc/status.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"

namespace pleat::client {
namespace {

constexpr std::chrono::milliseconds kReconnectPause{200};

}  // namespace

std::string state_name(v1::Job::State state) {
  switch (state) {
    case v1::Job::STATE_QUEUED:
      return "queued";
    case v1::Job::STATE_RUNNING:
      return "running";
    case v1::Job::STATE_REFERENCE:
      return "simulating the reference";
    case v1::Job::STATE_DONE:
      return "done";
    case v1::Job::STATE_FAILED:
      return "failed";
    case v1::Job::STATE_CANCELLED:
      return "cancelled";
    default:
      return "unknown";
  }
}

bool has_ended(v1::Job::State state) {
  return state == v1::Job::STATE_DONE || state == v1::Job::STATE_FAILED || state == v1::Job::STATE_CANCELLED;
}

struct JobWatcher::State {
  State(const std::shared_ptr<grpc::Channel>& channel, std::string peer, CallMetadata metadata, std::string job_id,
        JobSinks sinks, const JobWatchOptions& options)
      : stub_(v1::Coordinator::NewStub(channel)),
        peer_(std::move(peer)),
        metadata_(std::move(metadata)),
        job_id_(std::move(job_id)),
        sinks_(std::move(sinks)),
        patience_(options.patience),
        next_index_(options.from_index),
        last_heard_(std::chrono::steady_clock::now()),
        thread_([this] { run(); }) {}
  ~State() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
      if (context_ != nullptr) context_->TryCancel();
    }
    changed_.notify_all();
    thread_.join();
  }

  JobProgress wait(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [this] { return over_; });
    if (error_) throw *error_;
    return {job_, over_};
  }

 private:
  void run();
  /// One stream. True: the job has ended and everything was sent.
  bool watch_once();
  void handle(const v1::JobEvent& event);
  void handle_frame(const EnhancedFrame& frame);

  std::unique_ptr<v1::Coordinator::Stub> stub_;
  std::string peer_;
  CallMetadata metadata_;
  std::string job_id_;
  JobSinks sinks_;
  std::chrono::seconds patience_;
  std::mutex mutex_;
  std::condition_variable changed_;
  grpc::ClientContext* context_ = nullptr;  ///< of the running call
  v1::Job job_;
  bool over_ = false, stopping_ = false;
  std::optional<Error> error_;
  std::uint64_t next_index_;
  std::size_t fine_vertices_ = 0;
  std::chrono::steady_clock::time_point last_heard_;
  std::thread thread_;
};

void JobWatcher::State::run() {
  std::optional<Error> error;
  try {
    while (!watch_once()) {
      std::unique_lock lock(mutex_);
      if (changed_.wait_for(lock, kReconnectPause, [this] { return stopping_; })) break;
    }
  } catch (const Error& caught) {
    error = caught;
  } catch (const std::exception& caught) {
    error.emplace(ErrorCode::kInternal, caught.what());
  }
  const std::lock_guard lock(mutex_);
  error_ = error;
  over_ = true;
  changed_.notify_all();
}

void JobWatcher::State::handle_frame(const EnhancedFrame& frame) {
  if (frame.index < next_index_) return;  // sent again after a lost connection
  if (sinks_.frame) sinks_.frame(frame);
  next_index_ = frame.index + 1;
}

void JobWatcher::State::handle(const v1::JobEvent& event) {
  switch (event.event_case()) {
    case v1::JobEvent::kProgress: {
      const std::lock_guard lock(mutex_);
      job_ = event.progress();
      break;
    }
    case v1::JobEvent::kOpened: {
      JobMeshes meshes{from_message(event.opened().coarse(), "opened.coarse"),
                       from_message(event.opened().fine(), "opened.fine"),
                       {}};
      for (const v1::ObstacleShape& shape : event.opened().obstacles()) meshes.obstacles.push_back(from_message(shape));
      fine_vertices_ = meshes.fine.vertex_count();
      if (sinks_.opened) sinks_.opened(meshes);
      break;
    }
    case v1::JobEvent::kFrame:
      handle_frame(from_message(event.frame(), fine_vertices_));
      break;
    case v1::JobEvent::kError: {
      EnhancedFrame frame = from_message(event.error());
      if (event.has_replacement()) {
        EnhancedFrame stored = from_message(event.replacement(), fine_vertices_);
        stored.error = std::move(frame.error);
        frame = std::move(stored);
      }
      handle_frame(frame);
      break;
    }
    case v1::JobEvent::EVENT_NOT_SET:
      break;
  }
}

bool JobWatcher::State::watch_once() {
  grpc::ClientContext context;
  {
    const std::lock_guard lock(mutex_);
    if (stopping_) return true;
    context_ = &context;
  }
  metadata_.add_to(context);
  v1::WatchJobRequest request;
  request.set_id(job_id_);
  request.set_from_index(next_index_);
  request.set_include_frames(sinks_.wants_frames());
  const auto reader = stub_->WatchJob(&context, request);
  v1::JobEvent event;
  std::optional<Error> failure;
  while (!failure && reader->Read(&event)) {
    last_heard_ = std::chrono::steady_clock::now();
    try {
      handle(event);
    } catch (const Error& caught) {
      failure = caught;
    } catch (const std::exception& caught) {
      failure.emplace(ErrorCode::kInternal, caught.what());
    }
    if (failure) context.TryCancel();
  }
  const grpc::Status status = reader->Finish();
  bool done = false;
  {
    const std::lock_guard lock(mutex_);
    context_ = nullptr;
    done = stopping_ || (status.ok() && has_ended(job_.state()));
  }
  if (failure) throw *failure;
  if (done) return true;
  if (!status.ok() && status.error_code() != grpc::StatusCode::UNAVAILABLE &&
      status.error_code() != grpc::StatusCode::CANCELLED)
    rpc::throw_if_failed(status, peer_);
  if (std::chrono::steady_clock::now() - last_heard_ > patience_)
    throw Error(ErrorCode::kUnavailable, peer_ + ": lost, and not back after " + std::to_string(patience_.count()) +
                                             " s (" + status.error_message() + ")");
  return false;
}

JobWatcher::JobWatcher(const std::shared_ptr<grpc::Channel>& channel, std::string peer, const CallMetadata& metadata,
                       std::string job_id, JobSinks sinks, const JobWatchOptions& options)
    : state_(
          std::make_unique<State>(channel, std::move(peer), metadata, std::move(job_id), std::move(sinks), options)) {}
JobWatcher::JobWatcher(JobWatcher&&) noexcept = default;
JobWatcher& JobWatcher::operator=(JobWatcher&&) noexcept = default;
JobWatcher::~JobWatcher() = default;

JobProgress JobWatcher::wait(std::chrono::milliseconds timeout) const { return state_->wait(timeout); }

}  // namespace pleat::client
