#include "services/coordinator/result_events.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include "common/frame/messages.hpp"
#include "services/coordinator/recorder.hpp"

namespace pleat::coordinator {
namespace {

constexpr const char* kStoredErrorMessage = "the frame could not be enhanced; the file has the upsampled coarse mesh";

void set_positions(v1::Frame* frame, const Positions& positions) {
  frame->mutable_positions()->Assign(positions.data(), positions.data() + positions.size());
}

std::uint32_t sum(const std::vector<std::uint32_t>& values) {
  return std::accumulate(values.begin(), values.end(), std::uint32_t{0});
}

}  // namespace

EventPtr make_opened_event(const MeshPair& topology, const std::vector<ObstacleShape>& obstacles) {
  auto event = std::make_shared<v1::JobEvent>();
  v1::JobOpened& opened = *event->mutable_opened();
  *opened.mutable_coarse() = to_message(topology.coarse);
  *opened.mutable_fine() = to_message(topology.fine);
  for (const ObstacleShape& obstacle : obstacles) *opened.add_obstacles() = to_message(obstacle);
  return event;
}

EventPtr make_event(PipelineFrame& frame) {
  auto event = std::make_shared<v1::JobEvent>();
  if (frame.error) *event->mutable_error() = *frame.error;
  v1::EnhancedFrame& enhanced = frame.error ? *event->mutable_replacement() : *event->mutable_frame();
  enhanced.mutable_fine()->Swap(&frame.fine);
  enhanced.mutable_fine()->set_index(frame.index);
  enhanced.mutable_coarse()->Swap(&frame.coarse);
  enhanced.mutable_coarse()->clear_velocities();
  enhanced.mutable_report()->Swap(&frame.report);
  if (frame.pinch) *enhanced.mutable_coarse_pinch() = *frame.pinch;
  if (frame.fold.steps() > 0) enhanced.mutable_fold()->Swap(&frame.fold);
  enhanced.mutable_stage_times()->Swap(&frame.stage_times);
  enhanced.mutable_obstacles()->Swap(&frame.obstacles);
  return event;
}

ResultFrame read_result_frame(const ResultReader& reader, std::uint64_t index) {
  const std::uint64_t end = index + 1;
  ResultFrame frame;
  frame.time_s = reader.times(index, end).front();
  frame.coarse = std::move(reader.coarse(index, end).front());
  frame.enhanced = std::move(reader.enhanced(index, end).front());
  frame.obstacles = std::move(reader.obstacles(index, end).front());
  for (const std::string& stage : reader.info().stages) {
    frame.stages_ms.push_back(reader.stage_ms(stage, index, end).front());
  }
  for (const std::string& name : reader.info().counts) frame.counts.push_back(reader.counts(name, index, end).front());
  return frame;
}

EventPtr read_event(const ResultReader& reader, std::uint64_t index) {
  const ResultFrame stored = read_result_frame(reader, index);
  const auto count = [&](const std::string& name) {
    for (std::size_t i = 0; i < stored.counts.size(); ++i) {
      if (reader.info().counts[i] == name) return stored.counts[i];
    }
    return 0U;
  };
  auto event = std::make_shared<v1::JobEvent>();
  if (count("frame_errors") != 0) {
    event->mutable_error()->set_index(index);
    event->mutable_error()->set_code(13);
    event->mutable_error()->set_message(kStoredErrorMessage);
  }
  v1::EnhancedFrame& enhanced = event->has_error() ? *event->mutable_replacement() : *event->mutable_frame();
  for (v1::Frame* frame : {enhanced.mutable_fine(), enhanced.mutable_coarse()}) {
    frame->set_index(index);
    frame->set_time_s(stored.time_s);
  }
  set_positions(enhanced.mutable_fine(), stored.enhanced);
  set_positions(enhanced.mutable_coarse(), stored.coarse);
  enhanced.mutable_report()->set_penetrations_after(count("penetrations"));
  enhanced.mutable_report()->set_self_intersections_after(count("self_intersections"));
  const auto& counts = reader.info().counts;
  if (std::find(counts.begin(), counts.end(), "fold_steps") != counts.end()) {
    enhanced.mutable_fold()->set_steps(count("fold_steps"));
    enhanced.mutable_fold()->set_restarted(count("fold_restarts") != 0);
  }
  enhanced.mutable_report()->set_input_intersects(count("input_intersects") != 0);
  for (std::size_t i = 0; i < stored.stages_ms.size(); ++i) {
    v1::StageTime& time = *enhanced.add_stage_times();
    time.set_stage(reader.info().stages[i]);
    time.set_ms(static_cast<double>(stored.stages_ms[i]));
  }
  for (const ObstacleFrame& obstacle : stored.obstacles) *enhanced.add_obstacles() = to_message(obstacle);
  return event;
}

Counts counts_of(const std::filesystem::path& file) {
  Counts counts;
  if (!std::filesystem::exists(file)) return counts;
  try {
    const ResultReader reader(file, FileOrigin::kOwn);
    const std::uint64_t frames = reader.frames_complete();
    counts.penetrations = sum(reader.counts("penetrations", 0, frames));
    counts.self_intersections = sum(reader.counts("self_intersections", 0, frames));
    counts.frame_errors = sum(reader.counts("frame_errors", 0, frames));
  } catch (const Error&) {
    return {};
  }
  return counts;
}

}  // namespace pleat::coordinator
