// Ranges of channels: measured over a training split, taken off what a network reads, put back on what it answers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "common/features/frame_features.hpp"
#include "common/frame/frame.hpp"

namespace pleat {

/// One offset and scale per channel: normalised = (x - offset) / scale.
/// An empty range (scale 0) is a channel that never changed: it says nothing, so it is normalised to 0 whatever its
/// value, and every normalised value comes back as its offset.
/// Without channels: values stay physical.
struct ChannelRanges {
  std::vector<float> offset;
  std::vector<float> scale;  ///< >= 0
  /// > 0: normalised values beyond +-limit are cut to it. 0: values are kept as they are.
  float limit = 0;

  std::size_t channels() const { return offset.size(); }
  bool empty() const { return offset.empty(); }
  bool operator==(const ChannelRanges&) const = default;
};

/// Throws kInvalidArgument, beginning with `name`, unless there are `channels` offsets and scales (or none), all
/// finite, and no scale or limit is negative.
void check_ranges(const ChannelRanges& ranges, std::size_t channels, const std::string& name);

/// In place, values in planes, channel by channel: (C, ...). No effect without channels. Returns how many values lie
/// outside what was measured: [0, 1], or +-limit where there is one; none are counted of an empty range.
/// Throws kInvalidArgument if the sizes do not belong together.
std::size_t normalize(const ChannelRanges& ranges, std::span<float> values);
std::size_t normalize(const ChannelRanges& ranges, Tensor& tensor);

/// The inverse, in place, of values that were not cut.
void denormalize(const ChannelRanges& ranges, std::span<float> values);
void denormalize(const ChannelRanges& ranges, Tensor& tensor);

/// Gathers values of `channels` channels, to tell what range they have. Not thread-safe; merge() joins the measures
/// of several threads.
class RangeMeasure {
 public:
  explicit RangeMeasure(std::size_t channels) : channels_(channels) {}

  /// Values in planes, (C, n). mask: (n), entries that are 0 are left out; empty: all count.
  void add(std::span<const float> values, std::span<const std::uint8_t> mask = {});
  void add(const Tensor& tensor, std::span<const std::uint8_t> mask = {});
  /// Of nine channels.
  void add(const FrameFeatures& features);
  void merge(const RangeMeasure& other);

  /// Values per channel so far.
  std::size_t count() const { return count_; }

  /// From the smallest to the largest value, both widened by `margin` times their distance: offset, and scale.
  /// Throws kFailedPrecondition if nothing was added.
  ChannelRanges extremes(double margin = 0) const;
  /// Mean and standard deviation: offset, and scale. Deviations below 1e-9 are 0. Throws as extremes() does.
  ChannelRanges moments() const;

 private:
  struct Channel {
    float minimum = std::numeric_limits<float>::infinity(), maximum = -std::numeric_limits<float>::infinity();
    double sum = 0, squares = 0;
    void add(float value) {
      minimum = value < minimum ? value : minimum;
      maximum = value > maximum ? value : maximum;
      sum += static_cast<double>(value);
      squares += static_cast<double>(value) * static_cast<double>(value);
    }
  };
  std::vector<Channel> channels_;
  std::size_t count_ = 0;
};

}  // namespace pleat
