#include "services/coordinator/recorder.hpp"

#include <algorithm>
#include <map>
#include <string_view>
#include <utility>

#include "common/telemetry/stage_timer.hpp"

namespace pleat::coordinator {
namespace {

Positions positions_of(const v1::Frame& frame) {
  return Eigen::Map<const Positions>(frame.positions().data(), frame.positions_size() / 3, 3);
}

ObstacleFrame obstacle_of(const v1::ObstacleFrame& message) {
  ObstacleFrame obstacle;
  obstacle.name = message.name();
  if (message.center_size() == 3) obstacle.center = Eigen::Map<const Eigen::Vector3f>(message.center().data());
  obstacle.radius = message.radius();
  obstacle.positions = Eigen::Map<const Positions>(message.positions().data(), message.positions_size() / 3, 3);
  obstacle.capsule_ends =
      Eigen::Map<const Positions>(message.capsule_ends().data(), message.capsule_ends_size() / 3, 3);
  obstacle.capsule_radii.assign(message.capsule_radii().begin(), message.capsule_radii().end());
  return obstacle;
}

/// A failed frame gets the mesh that the file holds in its place, for those who watch.
void set_fine(PipelineFrame& frame, const ResultFrame& stored) {
  frame.fine.set_time_s(stored.time_s);
  const Positions& positions = stored.enhanced;
  frame.fine.mutable_positions()->Assign(positions.data(), positions.data() + positions.size());
}

}  // namespace

JobColumns job_columns(v1::Detail detail) {
  JobColumns columns{stage_names(detail), {"penetrations", "self_intersections", "frame_errors", "input_intersects"}};
  columns.stages.insert(columns.stages.begin(), "simulation");
  columns.stages.push_back("store");
  if (uses_fold(detail)) columns.counts.insert(columns.counts.end(), {"fold_steps", "fold_restarts"});
  return columns;
}

ResultFrame to_result_frame(const PipelineFrame& frame, const Subdivision& subdivision, const Faces& coarse_faces,
                            const JobColumns& columns, float store_ms) {
  ResultFrame result;
  result.time_s = frame.coarse.time_s();
  result.coarse = positions_of(frame.coarse);
  result.enhanced = frame.error ? upsample(subdivision, coarse_faces, result.coarse) : positions_of(frame.fine);
  for (const auto& obstacle : frame.obstacles) result.obstacles.push_back(obstacle_of(obstacle));
  for (const std::string& stage : columns.stages) {
    float ms = stage == "store" ? store_ms : 0;
    for (const v1::StageTime& time : frame.stage_times) {
      if (time.stage() == stage) ms += static_cast<float>(time.ms());
    }
    result.stages_ms.push_back(ms);
  }
  const std::map<std::string_view, std::uint32_t> counts{
      {"penetrations", frame.report.penetrations_after()},
      {"self_intersections", frame.report.self_intersections_after()},
      {"frame_errors", frame.error ? 1U : 0U},
      {"input_intersects", frame.report.input_intersects() ? 1U : 0U},
      {"fold_steps", frame.fold.steps()},
      {"fold_restarts", frame.fold.restarted() ? 1U : 0U}};
  for (const std::string& name : columns.counts) result.counts.push_back(counts.at(name));
  return result;
}

Recorder::Recorder(const std::filesystem::path& path, const ResultOptions& options, const Subdivision& subdivision,
                   std::size_t capacity, Callbacks callbacks)
    : subdivision_(subdivision),
      coarse_faces_(options.topology.coarse.faces),
      columns_{options.stages, options.counts},
      capacity_(std::max<std::size_t>(1, capacity)),
      callbacks_(std::move(callbacks)),
      writer_(path, options, true),
      first_index_(writer_.frames_complete()),
      thread_([this] { run(); }) {}

Recorder::~Recorder() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = abandoned_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

bool Recorder::add(FramePtr frame) {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return failure_ || closed_ || waiting_.size() < capacity_; });
  if (failure_ || closed_) return false;
  waiting_.push_back(std::move(frame));
  changed_.notify_all();
  return true;
}

void Recorder::finish() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
  if (failure_) throw *failure_;
  writer_.finish();
}

void Recorder::salvage() noexcept {
  try {
    {
      const std::lock_guard lock(mutex_);
      closed_ = abandoned_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
    if (writer_.frames_complete() > 0) writer_.finish();
  } catch (const std::exception&) {
    // The .partial stays, and it is readable.
  }
}

void Recorder::run() {
  float store_ms = 0;
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return closed_ || !waiting_.empty(); });
    if (abandoned_ || waiting_.empty()) return;
    const FramePtr frame = std::move(waiting_.front());
    waiting_.pop_front();
    changed_.notify_all();
    lock.unlock();
    std::optional<Error> failure;
    try {
      const telemetry::StageTimer timer;
      const ResultFrame result = to_result_frame(*frame, subdivision_, coarse_faces_, columns_, store_ms);
      writer_.append(result);
      if (frame->error) set_fine(*frame, result);
      store_ms = static_cast<float>(timer.milliseconds());
      callbacks_.stored(frame, writer_.frames_complete());
    } catch (const Error& e) {
      failure = e;
    } catch (const std::exception& e) {
      failure = Error(ErrorCode::kInternal, std::string("storing frame: ") + e.what());
    }
    if (failure) callbacks_.failed(*failure);
    lock.lock();
    if (failure) {
      failure_ = failure;
      changed_.notify_all();
      return;
    }
  }
}

}  // namespace pleat::coordinator
