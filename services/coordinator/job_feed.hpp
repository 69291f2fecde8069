// The newest frames of a running job, for those who watch it live.
#pragma once

#include <deque>
#include <memory>
#include <mutex>
#include <optional>

#include "pleat/v1/coordinator.pb.h"

namespace pleat::coordinator {

/// Bounded by count and by bytes; older frames are in the result file. Watchers share the messages, and a slow one
/// holds up nobody. Thread-safe.
class JobFeed {
 public:
  using Event = std::shared_ptr<const v1::JobEvent>;

  explicit JobFeed(std::size_t frames = 16, std::size_t bytes = std::size_t{64} << 20)
      : frames_(frames), bytes_(bytes) {}

  void set_opened(Event opened) {
    const std::lock_guard lock(mutex_);
    opened_ = std::move(opened);
  }
  Event opened() const {
    const std::lock_guard lock(mutex_);
    return opened_;
  }

  /// Frames come in order, without gaps.
  void publish(std::uint64_t index, Event event) {
    const std::lock_guard lock(mutex_);
    held_ += event->ByteSizeLong();
    ring_.push_back(std::move(event));
    end_ = index + 1;
    while (ring_.size() > frames_ || (held_ > bytes_ && ring_.size() > 1)) {
      held_ -= ring_.front()->ByteSizeLong();
      ring_.pop_front();
    }
  }

  /// Null if the frame is too old, or not there yet.
  Event frame(std::uint64_t index) const {
    const std::lock_guard lock(mutex_);
    const std::uint64_t first = end_ - ring_.size();
    return index >= first && index < end_ ? ring_[index - first] : nullptr;
  }

 private:
  const std::size_t frames_, bytes_;
  mutable std::mutex mutex_;
  Event opened_;
  std::deque<Event> ring_;
  std::uint64_t end_ = 0;
  std::size_t held_ = 0;
};

}  // namespace pleat::coordinator
