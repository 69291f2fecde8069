#include "services/cli/result_recorder.hpp"

#include <algorithm>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"

namespace pleat::cli {

void ResultRecorder::add(const v1::EnhancedFrame& frame, const Positions& coarse,
                         const std::vector<ObstacleFrame>& obstacles) {
  const std::uint64_t index = frame.fine().index();
  if (index != frames_)
    throw_internal("frame " + std::to_string(index) + " came where frame " + std::to_string(frames_) + " was due");
  if (!writer_) {
    // Parts of a stage ("simulation.contact") are in their stage already.
    for (const v1::StageTime& time : frame.stage_times())
      if (time.stage().find('.') == std::string::npos) stages_.push_back(time.stage());
    ResultOptions file;
    file.topology = options_.topology;
    file.frames = options_.frames;
    file.frame_time_s = options_.frame_time_s;
    file.model = options_.model;
    file.scene = options_.scene;
    file.obstacles = options_.obstacles;
    for (const ObstacleFrame& obstacle : obstacles) file.obstacle_vertices.push_back(obstacle.positions.rows());
    file.stages = stages_;
    file.counts = {"penetrations", "self_intersections"};
    writer_.emplace(options_.path, file);
  }
  ResultFrame out;
  out.time_s = frame.fine().time_s();
  out.coarse = coarse;
  out.enhanced = positions_from_message(frame.fine());
  out.obstacles = obstacles;
  out.stages_ms.assign(stages_.size(), 0);
  for (const v1::StageTime& time : frame.stage_times()) {
    const auto found = std::find(stages_.begin(), stages_.end(), time.stage());
    if (found != stages_.end())
      out.stages_ms[static_cast<std::size_t>(found - stages_.begin())] += static_cast<float>(time.ms());
  }
  out.counts = {frame.report().penetrations_after(), frame.report().self_intersections_after()};
  writer_->append(out);
  penetrations_ += frame.report().penetrations_after();
  self_intersections_ += frame.report().self_intersections_after();
  ++frames_;
}

void ResultRecorder::finish() {
  if (!writer_) throw Error(ErrorCode::kFailedPrecondition, options_.path.string() + ": no frame to keep");
  writer_->finish();
}

}  // namespace pleat::cli
