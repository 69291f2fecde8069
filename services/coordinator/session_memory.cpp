#include "services/coordinator/session_memory.hpp"

#include <algorithm>

#include "common/base/error.hpp"

namespace pleat::coordinator {
namespace {

/// Frames that EarlierFrames fills the next window from, and at least the one that velocities are differences to.
std::size_t earlier_frames(const v1::Representation& representation) {
  const std::size_t stride = std::max<std::uint32_t>(representation.window_stride(), 1);
  return std::max<std::size_t>(1, stride * (std::max<std::uint32_t>(representation.window(), 1) - 1));
}

}  // namespace

SessionMemory::SessionMemory(const PipelineSession& session, std::uint32_t interval)
    : interval_(interval),
      earlier_(earlier_frames(session.representation)),
      fold_(uses_fold(session.detail)),
      network_(network_remembers(session)) {
  constant_.set_topology_hash(session.coarse.hash());
  if (uses_network(session.detail)) constant_.set_model(session.model.SerializeAsString());
}

void SessionMemory::remember(std::uint64_t sequence, const v1::Frame& coarse) {
  if (interval_ == 0) return;
  const std::lock_guard lock(mutex_);
  recent_.emplace_back(sequence, coarse);
}

std::string SessionMemory::checkpoint(const PipelineFrame& frame) {
  if (interval_ == 0) return {};
  const std::lock_guard lock(mutex_);
  ++answered_;
  const auto after =
      std::find_if(recent_.begin(), recent_.end(), [&](const auto& known) { return known.first > frame.sequence; });
  const auto known = static_cast<std::size_t>(after - recent_.begin());
  if (known > earlier_) recent_.erase(recent_.begin(), recent_.begin() + static_cast<std::ptrdiff_t>(known - earlier_));
  // Behind a frame that failed the fold step has nothing to go on from, and neither has a network that remembers.
  if (answered_ < interval_ || frame.error || (fold_ && !frame.fold_memory)) return {};
  if (network_ && !frame.network_memory) return {};
  answered_ = 0;
  v1::SessionCheckpoint checkpoint = constant_;
  checkpoint.set_frames(frame.sequence + 1);
  for (const auto& [sequence, coarse] : recent_) {
    if (sequence <= frame.sequence) *checkpoint.add_earlier() = coarse;
  }
  if (fold_) *checkpoint.mutable_fold() = frame.fold_memory->state;
  if (network_) checkpoint.set_network_state(frame.network_memory->state);
  return checkpoint.SerializeAsString();
}

v1::SessionCheckpoint parse_checkpoint(const std::string& text, const PipelineSession& session) {
  constexpr std::uint64_t kMostFrames = std::uint64_t{1} << 48;
  v1::SessionCheckpoint checkpoint;
  if (!checkpoint.ParseFromString(text) || checkpoint.frames() == 0 || checkpoint.frames() > kMostFrames) {
    throw_invalid_argument("open.checkpoint: is none of a session");
  }
  if (checkpoint.topology_hash() != session.coarse.hash()) {
    throw_invalid_argument("open.checkpoint: is of a session with another mesh");
  }
  if (!uses_network(session.detail)) return checkpoint;
  v1::ModelDescription before;
  if (!before.ParseFromString(checkpoint.model())) throw_invalid_argument("open.checkpoint: its bundle is damaged");
  require_same_bundle(before, session.model);
  return checkpoint;
}

}  // namespace pleat::coordinator
