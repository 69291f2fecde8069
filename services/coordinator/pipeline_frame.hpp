// One frame on its way through the stages.
#pragma once

#include <google/protobuf/message.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "pleat/v1/common.pb.h"
#include "pleat/v1/conversion.pb.h"
#include "pleat/v1/fold.pb.h"

namespace pleat::coordinator {

using ObstacleFrames = google::protobuf::RepeatedPtrField<v1::ObstacleFrame>;
using StageTimes = google::protobuf::RepeatedPtrField<v1::StageTime>;

/// What the fold step left after a frame; its next frame goes on from there.
struct FoldMemory {
  std::uint64_t sequence = 0;
  v1::FoldState state;
};

/// The same of a network that remembers.
struct NetworkMemory {
  std::uint64_t sequence = 0;
  std::string state;  ///< ImageFrame.state
};

struct PipelineFrame {
  std::uint64_t sequence = 0;  ///< place in the session; the frame index between the services
  std::uint64_t index = 0;     ///< the client's frame index; equal to `sequence` in jobs
  v1::Frame coarse;            ///< with velocities
  /// Those before it that the network reads, the oldest first; the pipeline's, see EarlierFrames.
  std::vector<std::shared_ptr<const v1::Frame>> earlier;
  ObstacleFrames obstacles;
  v1::ImageFrame image;  ///< what the network reads after to_image, its answer after superres, empty after to_mesh
  v1::RigidTransform alignment;
  std::shared_ptr<const NetworkMemory> network_memory;  ///< after superres, if the network remembers
  v1::Frame fine;                                       ///< after to_mesh or fold; refined after refinement
  v1::FoldReport fold;
  std::shared_ptr<const FoldMemory> fold_memory;  ///< after fold
  v1::RefinementReport report;
  std::optional<v1::PinchReport> pinch;  ///< of the simulation
  StageTimes stage_times;
  std::optional<v1::FrameError> error;  ///< set: no stage touches the frame any more, it only keeps its place

  std::shared_ptr<const google::protobuf::Message> work;  ///< the request of the stage that the frame is in

  void fail(int code, const std::string& message) {
    error.emplace();
    error->set_index(index);
    error->set_code(code);
    error->set_message(message);
  }
};

/// The times that a stage's answer has; they are moved.
inline void add_times(PipelineFrame& frame, StageTimes& times) {
  for (v1::StageTime& time : times) frame.stage_times.Add(std::move(time));
  times.Clear();
}

/// The request of a stage that has answered or was given up: it is sent by nobody, and gives back what it was lent.
template <typename Request>
Request& sent(PipelineFrame& frame) {
  return const_cast<Request&>(static_cast<const Request&>(*frame.work));
}

}  // namespace pleat::coordinator
