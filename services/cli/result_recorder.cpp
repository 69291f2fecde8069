#include "services/cli/result_recorder.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "common/client/adapter/adapter.hpp"

namespace pleat::cli {

namespace {

/// Parts of a stage ("simulation.contact") are in their stage already.
std::vector<std::string> stages_of(const client::EnhancedFrame& frame, v1::Detail detail) {
  const std::vector<std::string> known = stage_names(detail);
  std::vector<std::string> stages;
  for (const client::StageTime& time : frame.stage_times) {
    const bool is_part = time.stage.find('.') != std::string::npos;
    if (!is_part || std::find(known.begin(), known.end(), time.stage) != known.end()) stages.push_back(time.stage);
  }
  return stages.empty() ? known : stages;
}

}  // namespace

void ResultRecorder::open(const client::EnhancedFrame& first, const std::vector<ObstacleFrame>& obstacles) {
  stages_ = stages_of(first, options_.detail);
  ResultOptions file;
  file.topology = options_.topology;
  file.frames = options_.frames;
  file.frame_time_s = options_.frame_time_s;
  file.model = options_.model;
  file.scene = options_.scene;
  file.obstacles = options_.obstacles;
  for (const ObstacleFrame& obstacle : obstacles) file.obstacle_vertices.push_back(obstacle.positions.rows());
  file.stages = stages_;
  file.counts = {"penetrations", "self_intersections", "frame_errors", "input_intersects"};
  folds_ = std::find(stages_.begin(), stages_.end(), "fold") != stages_.end();
  if (folds_) file.counts.insert(file.counts.end(), {"fold_steps", "fold_restarts"});
  writer_.emplace(options_.path, file);
}

void ResultRecorder::add(const client::EnhancedFrame& frame, Positions coarse, std::vector<ObstacleFrame> obstacles) {
  if (frame.index != frames_) {
    throw_internal("frame " + std::to_string(frame.index) + " came where frame " + std::to_string(frames_) +
                   " was due");
  }
  if (!writer_) open(frame, obstacles);
  ResultFrame out;
  out.time_s = frame.time_s;
  out.coarse = std::move(coarse);
  out.enhanced = client::to_positions(frame.positions);
  out.obstacles = std::move(obstacles);
  out.stages_ms.assign(stages_.size(), 0);
  for (const client::StageTime& time : frame.stage_times) {
    const auto found = std::find(stages_.begin(), stages_.end(), time.stage);
    if (found != stages_.end())
      out.stages_ms[static_cast<std::size_t>(found - stages_.begin())] += static_cast<float>(time.ms);
  }
  out.counts = {frame.report.penetrations_after, frame.report.self_intersections_after, frame.error ? 1u : 0u,
                frame.report.input_intersects ? 1u : 0u};
  if (folds_) {
    const client::FoldReport fold = frame.fold.value_or(client::FoldReport());
    out.counts.insert(out.counts.end(), {fold.steps, fold.restarted ? 1u : 0u});
  }
  writer_->append(out);
  penetrations_ += out.counts[0];
  self_intersections_ += out.counts[1];
  frame_errors_ += out.counts[2];
  ++frames_;
}

void ResultRecorder::finish() {
  if (!writer_) throw Error(ErrorCode::kFailedPrecondition, options_.path.string() + ": no frame to keep");
  writer_->finish();
}

}  // namespace pleat::cli
