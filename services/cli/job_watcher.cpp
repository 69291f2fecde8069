#include "services/cli/job_watcher.hpp"

#include "common/rpc/status.hpp"

namespace pleat::cli {
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

JobWatcher::JobWatcher(std::shared_ptr<grpc::Channel> channel, std::string address, std::string job_id, JobSinks sinks,
                       std::chrono::seconds patience)
    : stub_(v1::Coordinator::NewStub(channel)),
      address_(std::move(address)),
      job_id_(std::move(job_id)),
      sinks_(std::move(sinks)),
      patience_(patience),
      last_heard_(std::chrono::steady_clock::now()),
      thread_([this] { run(); }) {}

JobWatcher::~JobWatcher() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    if (context_ != nullptr) context_->TryCancel();
  }
  changed_.notify_all();
  thread_.join();
}

std::pair<v1::Job, bool> JobWatcher::wait(std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, timeout, [this] { return over_; });
  if (error_) throw *error_;
  return {job_, over_};
}

void JobWatcher::run() {
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

bool JobWatcher::watch_once() {
  grpc::ClientContext context;
  {
    const std::lock_guard lock(mutex_);
    if (stopping_) return true;
    context_ = &context;
  }
  v1::WatchJobRequest request;
  request.set_id(job_id_);
  request.set_from_index(next_index_);
  request.set_include_frames(sinks_.wants_frames());
  const auto reader = stub_->WatchJob(&context, request);
  v1::JobEvent event;
  bool ended = false;
  std::optional<Error> sink_error;
  while (!sink_error && reader->Read(&event)) {
    last_heard_ = std::chrono::steady_clock::now();
    try {
      switch (event.event_case()) {
        case v1::JobEvent::kProgress: {
          const std::lock_guard lock(mutex_);
          job_ = event.progress();
          ended = has_ended(job_.state());
          break;
        }
        case v1::JobEvent::kOpened:
          if (sinks_.opened) sinks_.opened(event.opened());
          break;
        case v1::JobEvent::kFrame:
          if (event.frame().fine().index() < next_index_) break;
          if (sinks_.frame) sinks_.frame(event.frame());
          next_index_ = event.frame().fine().index() + 1;
          break;
        case v1::JobEvent::kError:
          if (event.error().index() < next_index_) break;
          if (sinks_.frame_error) sinks_.frame_error(event.error());
          next_index_ = event.error().index() + 1;
          break;
        case v1::JobEvent::EVENT_NOT_SET:
          break;
      }
    } catch (const Error& caught) {
      sink_error = caught;
      context.TryCancel();
    }
  }
  const grpc::Status status = reader->Finish();
  bool stopping = false;
  {
    const std::lock_guard lock(mutex_);
    context_ = nullptr;
    stopping = stopping_;
  }
  if (sink_error) throw *sink_error;
  if (stopping || (status.ok() && ended)) return true;
  if (!status.ok() && status.error_code() != grpc::StatusCode::UNAVAILABLE &&
      status.error_code() != grpc::StatusCode::CANCELLED)
    rpc::throw_if_failed(status, "coordinator at " + address_);
  if (std::chrono::steady_clock::now() - last_heard_ > patience_)
    throw Error(ErrorCode::kUnavailable, "coordinator at " + address_ + ": lost, and not back after " +
                                             std::to_string(patience_.count()) + " s (" + status.error_message() + ")");
  return false;
}

}  // namespace pleat::cli
