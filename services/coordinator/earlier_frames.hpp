// The window of frames that a network reads at once.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <utility>
#include <vector>

#include "pleat/v1/common.pb.h"

namespace pleat::coordinator {

/// Remembers coarse frames, so that each frame travels with those before it and no stage has to remember any. A frame
/// that is sent again gets the same ones. Not thread-safe.
class EarlierFrames {
 public:
  using FramePtr = std::shared_ptr<const v1::Frame>;

  /// window: frames that the network reads, at least 1; with 1 nothing is remembered.
  explicit EarlierFrames(std::uint32_t window) : count_(window > 1 ? window - 1 : 0) {}

  /// The window - 1 frames with the largest indices below the frame's, the oldest first; where there are fewer, the
  /// oldest stands for those before it, and the frame itself where there is none. Remembers the frame.
  std::vector<FramePtr> fill(const v1::Frame& frame) {
    std::vector<FramePtr> earlier;
    if (count_ == 0) return earlier;
    const FramePtr kept = std::make_shared<const v1::Frame>(frame);
    std::erase_if(known_, [&](const FramePtr& known) { return known->index() == frame.index(); });
    for (const FramePtr& known : known_) {
      if (known->index() < frame.index()) earlier.push_back(known);
    }
    std::sort(earlier.begin(), earlier.end(), [](const auto& a, const auto& b) { return a->index() < b->index(); });
    if (earlier.size() > count_) earlier.erase(earlier.begin(), earlier.end() - static_cast<std::ptrdiff_t>(count_));
    earlier.insert(earlier.begin(), count_ - earlier.size(), earlier.empty() ? kept : earlier.front());
    known_.push_back(kept);
    // One more than a window, so that the newest frame can be sent again.
    if (known_.size() > count_ + 1) known_.pop_front();
    return earlier;
  }

 private:
  const std::size_t count_;
  std::deque<FramePtr> known_;  ///< as they came
};

}  // namespace pleat::coordinator
