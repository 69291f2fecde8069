#include "services/coordinator/job_runner.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <utility>

#include "common/base/thread_priority.hpp"
#include "common/base/whole_file.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/scene/animation_parts.hpp"
#include "common/store/result.hpp"
#include "common/telemetry/log.hpp"

namespace pleat::coordinator {
namespace {

namespace fs = std::filesystem;

constexpr char kCheckpointMagic[8] = {'P', 'L', 'E', 'A', 'T', 'C', 'P', '3'};
constexpr auto kCancelWait = std::chrono::seconds(5);
constexpr auto kSweepInterval = std::chrono::minutes(1);

/// What the files of a job take at most, before they are compressed: both meshes of every frame, and a second file with
/// the reference, which exists beside the first one for a while.
std::uint64_t bytes_of_job(std::uint64_t frames, std::uint64_t coarse_vertices, std::uint64_t fine_vertices,
                           bool reference) {
  constexpr std::uint64_t kBytesPerVertex = 3 * sizeof(float);
  const std::uint64_t vertices = coarse_vertices + fine_vertices;
  return frames * kBytesPerVertex * (reference ? 2 * vertices + fine_vertices : vertices);
}

std::string gigabytes(double bytes) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g GB", bytes * 1e-9);
  return text;
}

Animations share_animations(v1::Scene& scene) {
  return std::make_shared<const std::vector<v1::AnimationPart>>(take_animations(scene));
}

}  // namespace

std::optional<fs::path> result_file(const fs::path& job_folder) {
  for (const char* name : {"result.h5", "result.h5.partial"}) {
    if (fs::exists(job_folder / name)) return job_folder / name;
  }
  return std::nullopt;
}

void save_checkpoint(const fs::path& path, const Checkpoint& checkpoint) {
  const std::string fold = checkpoint.fold ? checkpoint.fold->state.SerializeAsString() : std::string();
  const std::string network = checkpoint.network ? checkpoint.network->state : std::string();
  const std::uint64_t header[] = {checkpoint.index, fold.size(), network.size()};
  std::string content(kCheckpointMagic, sizeof kCheckpointMagic);
  content.append(reinterpret_cast<const char*>(header), sizeof header);
  content += fold;
  content += network;
  content += checkpoint.state;
  write_whole_file(path, content);
}

std::optional<Checkpoint> load_checkpoint(const fs::path& path) {
  const auto content = path.empty() ? std::nullopt : read_file(path);
  Checkpoint checkpoint;
  std::uint64_t header[3] = {};
  constexpr std::size_t kHeader = sizeof kCheckpointMagic + sizeof header;
  if (!content || content->size() <= kHeader) return std::nullopt;
  if (std::memcmp(content->data(), kCheckpointMagic, sizeof kCheckpointMagic) != 0) return std::nullopt;
  std::memcpy(header, content->data() + sizeof kCheckpointMagic, sizeof header);
  const std::uint64_t fold_size = header[1], network_size = header[2], rest = content->size() - kHeader;
  checkpoint.index = header[0];
  if (fold_size >= rest || network_size >= rest - fold_size) return std::nullopt;
  if (fold_size > 0) {
    auto memory = std::make_shared<FoldMemory>();
    memory->sequence = checkpoint.index;
    if (!memory->state.ParseFromString(content->substr(kHeader, fold_size))) return std::nullopt;
    checkpoint.fold = std::move(memory);
  }
  if (network_size > 0) {
    auto memory = std::make_shared<NetworkMemory>();
    memory->sequence = checkpoint.index;
    memory->state = content->substr(kHeader + fold_size, network_size);
    checkpoint.network = std::move(memory);
  }
  checkpoint.state = content->substr(kHeader + fold_size + network_size);
  return checkpoint;
}

JobRunner::JobRunner(JobTable& table, ServiceAddresses addresses, LinkOptions link, JobSettings settings)
    : table_(table), addresses_(std::move(addresses)), link_(std::move(link)), settings_(settings) {
  for (const JobRecord& record : table_.unfinished()) {
    if (record.state != JobState::kQueued) {
      table_.update(record.id, [](JobRecord& unfinished) { unfinished.state = JobState::kQueued; });
    }
    queue_.push_back(record.id);
  }
  for (std::size_t i = 0; i < std::max<std::size_t>(1, settings_.concurrency); ++i) {
    workers_.emplace_back([this] { work(); });
  }
  if (settings_.keep_days > 0) sweeper_ = std::thread([this] { sweep(); });
}

JobRunner::~JobRunner() {
  stop();
  for (std::thread& worker : workers_) worker.join();
  if (sweeper_.joinable()) sweeper_.join();
}

JobRecord JobRunner::create(v1::CreateJobRequest request, const std::string& owner,
                            const telemetry::TraceContext& trace) {
  if (stopping()) throw Error(ErrorCode::kUnavailable, "the coordinator is stopping");
  if (!request.has_scene()) throw_invalid_argument("scene: is missing");
  v1::Scene& scene = *request.mutable_scene();
  if (!scene.name().empty() && !is_valid_job_id(scene.name())) {
    throw_invalid_argument("scene.name '" + scene.name() + "': at most 64 letters, digits, '-' or '_'");
  }
  if (request.frames() != 0) scene.set_frames(request.frames());
  if (scene.frames() == 0) throw_invalid_argument("scene.frames: is 0");
  // The job stays what it is, whatever the default becomes.
  request.set_detail(checked_detail(request.detail(), request.model(), "detail"));
  if (request.reference() && is_simulated(request.detail())) {
    throw_invalid_argument("reference: the fine cloth of a job of detail '" + std::string(name_of(request.detail())) +
                           "' is simulated itself");
  }
  if (scene.frames() > settings_.max_frames) {
    throw Error(ErrorCode::kResourceExhausted, "scene.frames: " + std::to_string(scene.frames()) + ", the limit is " +
                                                   std::to_string(settings_.max_frames));
  }
  JobRequest job{.id = request.job_id(),
                 .scene_name = scene.name(),
                 .frames = scene.frames(),
                 .reference = request.reference(),
                 .model = request.model(),
                 .request = request.SerializeAsString(),
                 .owner = owner,
                 .trace = trace.empty() ? telemetry::new_trace() : trace};
  // A request that is sent again asks the services for nothing.
  const bool known = !job.id.empty() && table_.contains(job.id);
  if (!known) {
    require_room(owner);
    const LinkOptions link = link_for(job.trace);
    const auto never = [] { return false; };
    const v1::ModelDescription model =
        uses_network(request.detail()) ? describe_model(addresses_, link, request.model(), never) : without_model();
    const auto animations = share_animations(scene);
    SimulationSource source(
        {.addresses = addresses_.simulation, .scene = scene, .animations = animations, .checkpoint = {}, .link = link});
    const Topology coarse = from_message(source.open().coarse(), "the simulation's coarse mesh");
    const v1::Representation representation = representation_of(scene, request.detail(), model);
    const std::string named = "scene '" + scene.name() + "'";
    const std::int64_t fine_vertices =
        admit(coarse.vertex_count(), subdivision_from(representation).rounds, settings_.max_vertices, named);
    job.bytes = bytes_of_job(scene.frames(), static_cast<std::uint64_t>(coarse.vertex_count()),
                             static_cast<std::uint64_t>(fine_vertices), request.reference());
    admit_bytes(owner, named, job.bytes);
    coarse_for_network(model, coarse);
  }
  const auto [record, made] = table_.create(job);
  if (made) {
    {
      const std::lock_guard lock(mutex_);
      queue_.push_back(record.id);
      show_queue();
    }
    changed_.notify_all();
  }
  return record;
}

void JobRunner::require_room(const std::string& owner) const {
  if (settings_.max_jobs_each > 0) {
    const std::size_t unfinished = table_.holdings(owner).unfinished;
    if (unfinished >= settings_.max_jobs_each) {
      throw Error(ErrorCode::kResourceExhausted,
                  owner + " has " + std::to_string(unfinished) + " jobs that have not ended already");
    }
  }
  if (!full()) return;
  throw Error(ErrorCode::kResourceExhausted, std::to_string(settings_.max_queued) + " jobs are waiting already");
}

bool JobRunner::full() const {
  const std::lock_guard lock(mutex_);
  return queue_.size() >= settings_.max_queued;
}

void JobRunner::admit_bytes(const std::string& owner, const std::string& scene, std::uint64_t bytes) const {
  const auto needed = static_cast<double>(bytes);
  if (settings_.max_gb_each > 0) {
    const auto held = static_cast<double>(table_.holdings(owner).bytes);
    if (held + needed > settings_.max_gb_each * 1e9) {
      throw Error(ErrorCode::kResourceExhausted, scene + " needs up to " + gigabytes(needed) + "; the jobs of " +
                                                     owner + " have " + gigabytes(held) + " of " +
                                                     gigabytes(settings_.max_gb_each * 1e9));
    }
  }
  const auto free = static_cast<double>(table_.free_bytes()), promised = static_cast<double>(table_.promised_bytes());
  if (needed + promised > free) {
    throw Error(ErrorCode::kResourceExhausted, scene + " needs up to " + gigabytes(needed) + " on disk; " +
                                                   gigabytes(std::max(0.0, free - promised)) + " are left");
  }
}

/// Removes what ended longer ago than jobs are kept, until the runner stops.
void JobRunner::sweep() {
  const double age_s = settings_.keep_days * 86'400;
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    lock.unlock();
    const double now = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
    for (const JobRecord& record : table_.list()) {
      if (!has_ended(record.state) || record.ended_s == 0 || now - record.ended_s < age_s) continue;
      try {
        const telemetry::TraceScope trace(record.trace);
        table_.remove(record.id);
        telemetry::audit("job " + record.id + " of " + record.owner + " removed: it ended long enough ago");
      } catch (const Error& error) {
        spdlog::warn("{}", error.what());
      }
    }
    lock.lock();
    changed_.wait_for(lock, kSweepInterval, [this] { return stopping_; });
  }
}

std::uint32_t JobRunner::queue_place(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = std::find(queue_.begin(), queue_.end(), id);
  return found == queue_.end() ? 0 : static_cast<std::uint32_t>(found - queue_.begin()) + 1;
}

/// With mutex_.
void JobRunner::show_queue() const {
  if (link_.metrics != nullptr) link_.metrics->set_queue_depth("jobs", queue_.size());
}

JobRecord JobRunner::cancel(const std::string& id) {
  JobRecord record = table_.get(id);
  if (has_ended(record.state)) return record;
  std::shared_ptr<ActiveJob> job;
  bool was_queued = false;
  {
    const std::lock_guard lock(mutex_);
    was_queued = std::erase(queue_, id) > 0;
    show_queue();
    if (const auto found = active_.find(id); found != active_.end()) job = found->second;
  }
  if (was_queued) return table_.update(id, [](JobRecord& queued) { queued.state = JobState::kCancelled; });
  if (job) job->abort(Error(ErrorCode::kCancelled, "cancelled"));
  const auto deadline = std::chrono::steady_clock::now() + kCancelWait;
  std::uint64_t revision = 0;
  do {
    std::tie(record, revision) = table_.wait(id, revision, std::chrono::milliseconds(200));
  } while (!has_ended(record.state) && std::chrono::steady_clock::now() < deadline);
  return record;
}

std::shared_ptr<ActiveJob> JobRunner::active(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = active_.find(id);
  return found == active_.end() ? nullptr : found->second;
}

void JobRunner::stop() {
  std::vector<std::shared_ptr<ActiveJob>> jobs;
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    for (const auto& [id, job] : active_) jobs.push_back(job);
  }
  changed_.notify_all();
  for (const auto& job : jobs) job->abort(Error(ErrorCode::kUnavailable, "the coordinator is stopping"));
}

bool JobRunner::stopping() const {
  const std::lock_guard lock(mutex_);
  return stopping_;
}

LinkOptions JobRunner::link_for(const telemetry::TraceContext& trace) const {
  LinkOptions link = link_;
  link.trace = trace;
  link.background = settings_.yield;
  return link;
}

void JobRunner::work() {
  if (settings_.yield) lower_thread_priority();
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return stopping_ || !queue_.empty(); });
    if (stopping_) return;
    auto job = std::make_shared<ActiveJob>(queue_.front());
    queue_.pop_front();
    show_queue();
    active_[job->id] = job;
    lock.unlock();
    execute(*job);
    lock.lock();
    active_.erase(job->id);
  }
}

void JobRunner::execute(ActiveJob& job) {
  // A job of a coordinator that knew no traces gets one.
  const JobRecord before = table_.get(job.id);
  const telemetry::TraceContext trace = before.trace.empty() ? telemetry::new_trace() : before.trace;
  const telemetry::TraceScope scope(trace);
  const LinkOptions link = link_for(trace);
  spdlog::info("job {}: from frame {} of {}", job.id, before.frames_complete, before.frames);
  std::optional<Error> failure;
  try {
    v1::CreateJobRequest request;
    if (!request.ParseFromString(table_.request(job.id))) {
      throw_data_loss((table_.folder(job.id) / "request.pb").string() + ": is corrupt");
    }
    const Animations animations = share_animations(*request.mutable_scene());
    const fs::path result = table_.folder(job.id) / "result.h5";
    table_.update(job.id, [&](JobRecord& record) {
      record.state = JobState::kRunning;
      record.trace = trace;
    });
    if (!fs::exists(result)) enhance(job, request, animations, link);
    if (request.reference() && !ResultReader(result, FileOrigin::kOwn).info().has_fine) {
      table_.update(job.id, [](JobRecord& record) { record.state = JobState::kReference; });
      simulate_reference(job, request, animations, link);
    }
    // A job that is taken up again from here has its whole result, and needs none of these.
    for (const char* scratch : {"bundle.pb", "checkpoint.bin", "reference_checkpoint.bin"}) {
      std::error_code ignored;
      fs::remove(table_.folder(job.id) / scratch, ignored);
    }
    const JobRecord done = table_.update(job.id, [](JobRecord& record) {
      record.state = JobState::kDone;
      record.frames_complete = record.frames;
      record.reference_frames_complete = record.reference ? record.frames : 0;
    });
    spdlog::info("job {}: done, {} frames in {:.1f} s", job.id, done.frames, done.wall_s);
  } catch (const Error& e) {
    failure = job.cause().value_or(e);
  } catch (const std::exception& e) {
    failure = Error(ErrorCode::kInternal, e.what());
  }
  if (!failure || stopping()) return;
  spdlog::warn("job {}: {}", job.id, failure->what());
  try {
    table_.update(job.id, [&](JobRecord& record) {
      record.state = failure->code() == ErrorCode::kCancelled ? JobState::kCancelled : JobState::kFailed;
      if (record.state == JobState::kFailed) record.error = failure->what();
    });
  } catch (const Error&) {
    // The disk is full even for the record: it is right in memory, and unfinished for the next start.
  }
}

}  // namespace pleat::coordinator
