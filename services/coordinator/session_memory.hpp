// What a live session leaves behind, so that it can go on in another coordinator, or in this one after a restart.
#pragma once

#include <cstdint>
#include <deque>
#include <mutex>
#include <string>
#include <utility>

#include "pleat/v1/coordinator.pb.h"
#include "services/coordinator/pipeline_session.hpp"

namespace pleat::coordinator {

/// Makes the checkpoints of a session. The client keeps them: a coordinator that starts knows nothing of sessions
/// before. Thread-safe: frames are remembered as they come, and answered by another thread.
class SessionMemory {
 public:
  /// interval: frames between checkpoints; 0: none, and nothing is remembered. session: complete but for what earlier
  /// sessions left.
  SessionMemory(const PipelineSession& session, std::uint32_t interval);

  /// A frame that is right, with velocities, in the order of the session.
  void remember(std::uint64_t sequence, const v1::Frame& coarse);

  /// A serialised SessionCheckpoint behind this frame, if one is due and the frame has not failed; else nothing. Frames
  /// in the order of the session, each once.
  std::string checkpoint(const PipelineFrame& frame);

 private:
  const std::uint32_t interval_;
  const std::size_t earlier_;  ///< frames before the next one that may be needed
  const bool fold_, network_;  ///< what goes on from what it left
  v1::SessionCheckpoint constant_;
  std::mutex mutex_;
  std::deque<std::pair<std::uint64_t, v1::Frame>> recent_;
  std::uint32_t answered_ = 0;  ///< since the last checkpoint
};

/// Throws kInvalidArgument unless the text is a checkpoint of a session with this mesh, kFailedPrecondition if the
/// bundle is another one by now. Its frames and state are for others to check.
v1::SessionCheckpoint parse_checkpoint(const std::string& text, const PipelineSession& session);

}  // namespace pleat::coordinator
