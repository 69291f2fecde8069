#include "services/coordinator/service.hpp"

#include <spdlog/spdlog.h>

#include <chrono>
#include <cmath>
#include <system_error>
#include <thread>
#include <utility>

#include "common/scene/animation_parts.hpp"
#include "services/coordinator/access.hpp"
#include "services/coordinator/result_events.hpp"
#include "services/coordinator/silence_watch.hpp"

namespace pleat::coordinator {
namespace {

constexpr auto kProgressInterval = std::chrono::seconds(1);

ServiceAddresses addresses_of(const CoordinatorOptions& options) {
  return {.simulation = split_addresses("simulation", options.simulation),
          .conversion = split_addresses("conversion", options.conversion),
          .superres = split_addresses("superres", options.superres),
          .refinement = split_addresses("refinement", options.refinement),
          .fold = split_addresses("fold", options.fold)};
}

std::chrono::milliseconds milliseconds_of(double seconds, const std::string& option) {
  if (!(seconds > 0 && seconds <= 86'400)) throw_invalid_argument("--" + option + ": must lie in (0, 86400]");
  return std::chrono::milliseconds(std::llround(seconds * 1e3));
}

LinkOptions link_of(const CoordinatorOptions& options, telemetry::Metrics* metrics,
                    std::shared_ptr<const std::atomic<bool>> stopping) {
  LinkOptions link;
  link.replicas = std::make_shared<ReplicaDirectory>();
  link.connect = [tls = options.service_tls, replicas = link.replicas](const std::string& address) {
    rpc::TlsOptions own = tls;
    // Replicas are reached by their numbers; their certificates have the name.
    if (own.server_name.empty()) own.server_name = replicas->name_of(address);
    return rpc::create_channel(address, own);
  };
  link.give_up = milliseconds_of(options.give_up_s, "give-up-s");
  link.open_timeout = link.answer_timeout = milliseconds_of(options.answer_timeout_s, "answer-timeout-s");
  link.metrics = metrics;
  link.stopping = std::move(stopping);
  return link;
}

JobSettings checked(JobSettings settings) {
  if (settings.window == 0) throw_invalid_argument("--window: must lie in [1, 64]");
  settings.window = rpc::checked_window(settings.window);
  if (!(settings.keep_days >= 0)) throw_invalid_argument("--keep-days: must be 0 or more");
  if (!(settings.max_gb_each >= 0)) throw_invalid_argument("--max-gb-each: must be 0 or more");
  return settings;
}

LiveSettings checked(LiveSettings settings) {
  milliseconds_of(settings.open_timeout_s, "open-timeout-s");
  milliseconds_of(settings.idle_timeout_s, "idle-timeout-s");
  return settings;
}

v1::Job::State to_message(JobState state) {
  switch (state) {
    case JobState::kQueued:
      return v1::Job::STATE_QUEUED;
    case JobState::kRunning:
      return v1::Job::STATE_RUNNING;
    case JobState::kReference:
      return v1::Job::STATE_REFERENCE;
    case JobState::kDone:
      return v1::Job::STATE_DONE;
    case JobState::kFailed:
      return v1::Job::STATE_FAILED;
    case JobState::kCancelled:
      return v1::Job::STATE_CANCELLED;
  }
  return v1::Job::STATE_UNSPECIFIED;
}

}  // namespace

CoordinatorService::CoordinatorService(const CoordinatorOptions& options, telemetry::Metrics* metrics)
    : callers_(options.token_file),
      table_(options.data),
      link_(link_of(options, metrics, draining_)),
      runner_(table_, addresses_of(options), link_, checked(options.jobs)),
      live_(addresses_of(options), link_, checked(options.live)),
      metrics_(metrics),
      reader_timeout_(milliseconds_of(options.live.reader_timeout_s, "reader-timeout-s")),
      watcher_quota_("watchers of jobs", options.max_watchers, options.max_watchers_each),
      idle_timeout_(milliseconds_of(options.live.idle_timeout_s, "idle-timeout-s")),
      upload_quota_("scenes on their way in parts", options.max_uploads, 0) {
  for (const std::string& warning : table_.warnings()) spdlog::warn("{}", warning);
}

grpc::Status CoordinatorService::CreateJob(grpc::ServerContext* context, const v1::CreateJobRequest* request,
                                           v1::Job* job) {
  return rpc::guard([&] {
    const telemetry::TraceContext trace = rpc::trace_of(*context);
    const telemetry::TraceScope scope(trace);
    const rpc::Caller caller = callers_.identify(*context);
    require_maker(caller, "make jobs");
    const JobRecord record = runner_.create(*request, caller.name, trace);
    audit(caller, record, "created (" + std::to_string(record.frames) + " frames of '" + record.scene_name + "')");
    *job = to_job(record);
  });
}

grpc::Status CoordinatorService::CreateJobInParts(grpc::ServerContext* context,
                                                  grpc::ServerReader<v1::CreateJobPart>* reader, v1::Job* job) {
  return rpc::guard([&] {
    const telemetry::TraceContext trace = rpc::trace_of(*context);
    const telemetry::TraceScope scope(trace);
    const rpc::Caller caller = callers_.identify(*context);
    require_maker(caller, "make jobs");
    {
      const std::lock_guard lock(uploads_mutex_);
      upload_quota_.enter(caller.name);
    }
    const std::shared_ptr<void> leave(nullptr, [&](void*) {
      const std::lock_guard lock(uploads_mutex_);
      upload_quota_.leave(caller.name);
    });
    const JobRecord record = receive_job(*context, *reader, caller.name, trace);
    audit(caller, record,
          "created in parts (" + std::to_string(record.frames) + " frames of '" + record.scene_name + "')");
    *job = to_job(record);
  });
}

JobRecord CoordinatorService::receive_job(grpc::ServerContext& context, grpc::ServerReader<v1::CreateJobPart>& reader,
                                          const std::string& owner, const telemetry::TraceContext& trace) {
  SilenceWatch silence(context, idle_timeout_);
  const auto read = [&](v1::CreateJobPart& part) {
    if (*draining_) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
    return silence.during([&] { return reader.Read(&part); });
  };
  v1::CreateJobPart part;
  if (!read(part) || !part.has_request()) throw_invalid_argument("the first part of a job must be its request");
  v1::CreateJobRequest request = std::move(*part.mutable_request());
  AnimationAssembly assembly(*request.mutable_scene(), "scene");
  while (!assembly.complete()) {
    if (!read(part)) throw_invalid_argument("the parts ended too early: " + assembly.describe_missing());
    if (!part.has_animation()) throw_invalid_argument("after the request only parts of animations may follow");
    assembly.add(part.animation());
  }
  part.Clear();
  if (read(part)) throw_invalid_argument("no more parts than the scene announces may follow");
  return runner_.create(std::move(request), owner, trace);
}

grpc::Status CoordinatorService::CancelJob(grpc::ServerContext* context, const v1::CancelJobRequest* request,
                                           v1::Job* job) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    const rpc::Caller caller = callers_.identify(*context);
    require_owner(caller, table_.get(request->id()));
    const JobRecord record = runner_.cancel(request->id());
    audit(caller, record, "cancelled");
    *job = to_job(record);
  });
}

grpc::Status CoordinatorService::ListJobs(grpc::ServerContext* context, const v1::ListJobsRequest* request,
                                          v1::ListJobsResponse* response) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    const rpc::Caller caller = callers_.identify(*context);
    if (request->live_sessions()) {
      for (const auto& feed : live_.feeds()) {
        const JobRecord record = feed->record();
        if (may_read(caller, record)) *response->add_jobs() = to_job(record);
      }
    }
    for (const JobRecord& record : table_.list()) {
      if (may_read(caller, record)) *response->add_jobs() = to_job(record);
    }
  });
}

grpc::Status CoordinatorService::GetJob(grpc::ServerContext* context, const v1::GetJobRequest* request, v1::Job* job) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    const rpc::Caller caller = callers_.identify(*context);
    const JobRecord record = record_of(request->id());
    require_reader(caller, record);
    *job = to_job(record);
  });
}

grpc::Status CoordinatorService::RemoveJob(grpc::ServerContext* context, const v1::RemoveJobRequest* request,
                                           v1::Job* job) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    const rpc::Caller caller = callers_.identify(*context);
    const JobRecord record = table_.get(request->id());
    require_owner(caller, record);
    v1::Job was = to_job(record);
    table_.remove(request->id());
    audit(caller, record, "removed");
    *job = std::move(was);
  });
}

grpc::ServerBidiReactor<v1::EnhanceRequest, v1::EnhanceResponse>* CoordinatorService::Enhance(
    grpc::CallbackServerContext* context) {
  try {
    const telemetry::TraceContext trace = rpc::trace_of(*context);
    const rpc::Caller caller = callers_.identify(*context);
    require_maker(caller, "open live sessions");
    return live_.start(context, caller.name, trace);
  } catch (...) {
    const auto refused = LiveSessions::Reactor::make(context);
    refused->refuse(rpc::current_exception_status());
    return refused.get();
  }
}

bool CoordinatorService::has_room() const { return !*draining_ && live_.has_room() && !runner_.full(); }

CoordinatorService::~CoordinatorService() {
  std::unique_lock lock(watchers_mutex_);
  watchers_changed_.wait(lock, [this] { return watchers_.empty(); });
}

void CoordinatorService::drain() {
  *draining_ = true;
  {
    const std::lock_guard lock(watchers_mutex_);
    for (const auto& watcher : watchers_) watcher->interrupt();
  }
  live_.drain();
  runner_.stop();
}

/// One WatchJob call. It follows the job at its own pace: new frames come from the job's feed, older ones from its
/// file.
class CoordinatorService::Watcher {
 public:
  Watcher(const CoordinatorService& service, const v1::WatchJobRequest& request, EventWriter& writer)
      : service_(service), request_(request), writer_(writer), next_(request.from_index()) {}

  /// Until the job has ended and everything was sent. False: the client has gone.
  bool run() {
    std::uint64_t revision = 0;
    JobRecord record = service_.table_.get(request_.id());
    if (!send_progress(record)) return false;
    while (true) {
      if (writer_.gone()) return false;
      if (*service_.draining_) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
      // Frames before the end: what is complete now stays readable, whatever becomes of the job.
      if (request_.include_frames() && !send_frames(record.frames_complete)) return false;
      if (has_ended(record.state)) return true;
      std::tie(record, revision) = service_.table_.wait(request_.id(), revision, std::chrono::milliseconds(250));
      const bool due = std::chrono::steady_clock::now() - progress_sent_ >= kProgressInterval;
      if (has_ended(record.state) && request_.include_frames() && !send_frames(record.frames_complete)) return false;
      if ((due || record.state != state_sent_) && !send_progress(record)) return false;
    }
  }

 private:
  bool send_progress(const JobRecord& record) {
    v1::JobEvent event;
    *event.mutable_progress() = service_.to_job(record);
    progress_sent_ = std::chrono::steady_clock::now();
    state_sent_ = record.state;
    return write(event);
  }

  bool send_frames(std::uint64_t end) {
    if (next_ >= end) return true;
    const auto job = service_.runner_.active(request_.id());
    if (!opened_) {
      EventPtr opened = job ? job->feed.opened() : nullptr;
      if (!opened) {
        const ResultReader& reader = file(0);
        opened = make_opened_event(reader.info().topology, reader.info().obstacles);
      }
      if (!write(*opened)) return false;
      opened_ = true;
    }
    for (; next_ < end; ++next_) {
      EventPtr event = job ? job->feed.frame(next_) : nullptr;
      if (!event) event = read_event(file(next_), next_);
      if (!write(*event)) return false;
    }
    return true;
  }

  bool write(const v1::JobEvent& event) { return writer_.write(event, service_.reader_timeout_); }

  /// The result file, opened anew when it has grown beyond what the open one knows.
  const ResultReader& file(std::uint64_t index) {
    if (!reader_ || index >= reader_->frames_complete()) open_file();
    return *reader_;
  }

  void open_file() {
    for (bool again = false;; again = true) {
      const auto path = result_file(service_.table_.folder(request_.id()));
      if (!path) throw_not_found("job " + request_.id() + " has no result file");
      try {
        reader_.emplace(*path, FileOrigin::kOwn);
        return;
      } catch (const Error& error) {
        // Finished, and so renamed, since it was found.
        if (error.code() != ErrorCode::kNotFound || again) throw;
      }
    }
  }

  const CoordinatorService& service_;
  const v1::WatchJobRequest& request_;
  EventWriter& writer_;
  std::uint64_t next_;
  bool opened_ = false;
  std::optional<ResultReader> reader_;
  std::chrono::steady_clock::time_point progress_sent_{};
  JobState state_sent_ = JobState::kQueued;
};

grpc::ServerWriteReactor<v1::JobEvent>* CoordinatorService::WatchJob(grpc::CallbackServerContext* context,
                                                                     const v1::WatchJobRequest* asked) {
  auto writer = EventWriter::make(context);
  const std::lock_guard lock(watchers_mutex_);
  rpc::Caller caller;
  const grpc::Status admitted = rpc::guard([&] {
    caller = callers_.identify(*context);
    require_reader(caller, record_of(asked->id()));
    if (*draining_) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
    watcher_quota_.enter(caller.name);
  });
  if (!admitted.ok()) {
    writer->refuse(admitted);
    return writer.get();
  }
  watchers_.insert(writer);
  try {
    std::thread([this, writer, caller, request = *asked, trace = rpc::trace_of(*context)] {
      const telemetry::TraceScope scope(trace);
      watch(*writer, caller, request);
    }).detach();
  } catch (const std::system_error&) {
    watcher_quota_.leave(caller.name);
    watchers_.erase(writer);
    writer->refuse({grpc::StatusCode::UNAVAILABLE, "this host has no thread to spare"});
  }
  return writer.get();
}

void CoordinatorService::watch(EventWriter& writer, const rpc::Caller& caller, const v1::WatchJobRequest& request) {
  if (metrics_ != nullptr) metrics_->add_sessions(1);
  writer.finish(rpc::guard([&]() -> grpc::Status {
    const JobRecord record = record_of(request.id());
    if (caller.name != record.owner) audit(caller, record, "read");
    const bool live = request.id().starts_with(kLivePrefix);
    if (live ? watch_session(writer, request) : Watcher(*this, request, writer).run()) return grpc::Status::OK;
    return writer.timed_out() ? grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED, "the client does not read")
                              : grpc::Status(grpc::StatusCode::CANCELLED, "the client has gone");
  }));
  if (metrics_ != nullptr) metrics_->add_sessions(-1);
  const std::lock_guard ended(watchers_mutex_);
  watcher_quota_.leave(caller.name);
  std::erase_if(watchers_, [&](const auto& other) { return other.get() == &writer; });
  watchers_changed_.notify_all();
}

bool CoordinatorService::watch_session(EventWriter& writer, const v1::WatchJobRequest& request) {
  const std::shared_ptr<SessionFeed> feed = live_.feed(request.id());
  const SessionFeed::Watch watch(*feed);
  std::uint64_t revision = 0, shown = 0;
  bool opened = false;
  auto progress_sent = std::chrono::steady_clock::time_point{};
  while (true) {
    const SessionFeed::News news = feed->wait(revision, std::chrono::milliseconds(250));
    revision = news.revision;
    if (writer.gone()) return false;
    if (*draining_) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
    if (request.include_frames() && news.opened && !opened) {
      if (!writer.write(*news.opened, reader_timeout_)) return false;
      opened = true;
    }
    if (opened && news.frame && news.frame_revision > shown) {
      if (!writer.write(*news.frame, reader_timeout_)) return false;
      shown = news.frame_revision;
    }
    const bool over = has_ended(news.record.state);
    const auto now = std::chrono::steady_clock::now();
    if (over || now - progress_sent >= kProgressInterval) {
      v1::JobEvent event;
      *event.mutable_progress() = to_job(news.record);
      if (!writer.write(event, reader_timeout_)) return false;
      progress_sent = now;
    }
    if (over) return true;
  }
}

JobRecord CoordinatorService::record_of(const std::string& id) const {
  return id.starts_with(kLivePrefix) ? live_.feed(id)->record() : table_.get(id);
}

v1::Job CoordinatorService::to_job(const JobRecord& record) const {
  v1::Job job;
  job.set_id(record.id);
  job.set_scene_name(record.scene_name);
  job.set_state(to_message(record.state));
  job.set_frames(record.frames);
  job.set_frames_complete(record.frames_complete);
  job.set_reference_frames_complete(record.reference_frames_complete);
  job.set_error(record.error);
  if (!record.id.starts_with(kLivePrefix)) {
    const auto folder = table_.folder_of(record.id);
    job.set_result_path(std::filesystem::absolute(result_file(folder).value_or(folder / "result.h5")).string());
    job.set_queue_place(runner_.queue_place(record.id));
  }
  v1::JobSummary& summary = *job.mutable_summary();
  summary.set_coarse_vertices(record.coarse_vertices);
  summary.set_fine_vertices(record.fine_vertices);
  summary.set_wall_s(record.wall_s);
  summary.set_penetrations(record.penetrations);
  summary.set_self_intersections(record.self_intersections);
  summary.set_model(record.model);
  summary.set_device(record.device);
  summary.set_precision(record.precision);
  summary.set_frame_errors(record.frame_errors);
  summary.set_pinched_frames(record.pinched_frames);
  summary.set_pinch_depth_m(record.pinch_depth_m);
  summary.set_detail(detail_named(record.detail));
  for (const std::string& warning : record.warnings) job.add_warnings(warning);
  job.set_owner(record.owner);
  job.set_created_s(record.created_s);
  job.set_ended_s(record.ended_s);
  job.set_bytes(record.bytes);
  job.set_trace_id(record.trace.trace_id);
  return job;
}

}  // namespace pleat::coordinator
