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

  /// window: frames that the network reads, at least 1; with 1 nothing is remembered. stride: from one to the next, in
  /// frames, at least 1.
  explicit EarlierFrames(std::uint32_t window, std::uint32_t stride = 1)
      : count_(window > 1 ? window - 1 : 0), stride_(std::max<std::size_t>(1, stride)) {}

  /// Of the frames with indices below the frame's, from the largest index down, every stride-th: window - 1 of them,
  /// the oldest first. Where there are fewer, the oldest stands for those before it, and the frame itself where there
  /// is none. Remembers the frame.
  std::vector<FramePtr> fill(const v1::Frame& frame) {
    if (count_ == 0) return {};
    std::vector<FramePtr> before, earlier;
    const FramePtr kept = std::make_shared<const v1::Frame>(frame);
    std::erase_if(known_, [&](const FramePtr& known) { return known->index() == frame.index(); });
    for (const FramePtr& known : known_) {
      if (known->index() < frame.index()) before.push_back(known);
    }
    std::sort(before.begin(), before.end(), [](const auto& a, const auto& b) { return a->index() < b->index(); });
    if (before.empty()) before.push_back(kept);
    for (std::size_t back = count_ * stride_; back > 0; back -= stride_) {
      earlier.push_back(before[before.size() - std::min(back, before.size())]);
    }
    known_.push_back(kept);
    // One more than a window, so that the newest frame can be sent again.
    if (known_.size() > count_ * stride_ + 1) known_.pop_front();
    return earlier;
  }

 private:
  const std::size_t count_, stride_;
  std::deque<FramePtr> known_;  ///< as they came
};

}  // namespace pleat::coordinator
