#include "common/features/channel_ranges.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr double kSmallestDeviation = 1e-9;

std::size_t plane_of(const ChannelRanges& ranges, std::size_t values) {
  if (ranges.scale.size() != ranges.channels() || values % ranges.channels() != 0) {
    throw_invalid_argument("ranges of " + std::to_string(ranges.channels()) + " channels do not fit " +
                           std::to_string(values) + " values");
  }
  return values / ranges.channels();
}

void check_channels(const ChannelRanges& ranges, const Tensor& tensor) {
  if (ranges.empty()) return;
  if (tensor.shape.empty() || tensor.shape[0] != static_cast<std::int64_t>(ranges.channels())) {
    throw_invalid_argument("ranges of " + std::to_string(ranges.channels()) + " channels for a tensor of " +
                           std::to_string(tensor.shape.empty() ? 0 : tensor.shape[0]));
  }
}

}  // namespace

void check_ranges(const ChannelRanges& ranges, std::size_t channels, const std::string& name) {
  if (!(ranges.limit >= 0) || !std::isfinite(ranges.limit)) throw_invalid_argument(name + ": the limit is negative");
  if (ranges.offset.empty() && ranges.scale.empty()) return;
  if (ranges.offset.size() != channels || ranges.scale.size() != channels) {
    throw_invalid_argument(name + ": " + std::to_string(ranges.offset.size()) + " offsets and " +
                           std::to_string(ranges.scale.size()) + " scales, " + std::to_string(channels) +
                           " of each needed");
  }
  for (std::size_t c = 0; c < channels; ++c) {
    if (std::isfinite(ranges.offset[c]) && std::isfinite(ranges.scale[c]) && ranges.scale[c] >= 0) continue;
    throw_invalid_argument(name + ": the range of channel " + std::to_string(c) + " is not finite or inverted");
  }
}

std::size_t normalize(const ChannelRanges& ranges, std::span<float> values) {
  if (ranges.empty()) return 0;
  const std::size_t plane = plane_of(ranges, values.size());
  const float low = ranges.limit > 0 ? -ranges.limit : 0, high = ranges.limit > 0 ? ranges.limit : 1;
  std::size_t outside = 0;
  for (std::size_t c = 0; c < ranges.channels(); ++c) {
    float* row = values.data() + c * plane;
    const float offset = ranges.offset[c], scale = ranges.scale[c];
    if (!(scale > 0)) {
      std::fill_n(row, plane, 0.0F);
      continue;
    }
    std::uint32_t here = 0;
    for (std::size_t i = 0; i < plane; ++i) {
      // Division, because the largest value must become exactly 1.
      row[i] = (row[i] - offset) / scale;
      here += row[i] < low || row[i] > high ? 1U : 0U;
    }
    if (ranges.limit > 0) {
      for (std::size_t i = 0; i < plane; ++i) row[i] = std::min(std::max(row[i], low), high);
    }
    outside += here;
  }
  return outside;
}

std::size_t normalize(const ChannelRanges& ranges, Tensor& tensor) {
  check_channels(ranges, tensor);
  return normalize(ranges, tensor.values);
}

void denormalize(const ChannelRanges& ranges, std::span<float> values) {
  if (ranges.empty()) return;
  const std::size_t plane = plane_of(ranges, values.size());
  for (std::size_t c = 0; c < ranges.channels(); ++c) {
    float* row = values.data() + c * plane;
    const float offset = ranges.offset[c], scale = ranges.scale[c];
    for (std::size_t i = 0; i < plane; ++i) row[i] = row[i] * scale + offset;
  }
}

void denormalize(const ChannelRanges& ranges, Tensor& tensor) {
  check_channels(ranges, tensor);
  denormalize(ranges, tensor.values);
}

void RangeMeasure::add(std::span<const float> values, std::span<const std::uint8_t> mask) {
  const std::size_t plane = channels_.empty() ? 0 : values.size() / channels_.size();
  if (plane * channels_.size() != values.size() || (!mask.empty() && mask.size() != plane)) {
    throw_invalid_argument("a range of " + std::to_string(channels_.size()) +
                           " channels: values or mask of another size");
  }
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    const float* row = values.data() + c * plane;
    for (std::size_t i = 0; i < plane; ++i) {
      if (mask.empty() || mask[i] != 0) channels_[c].add(row[i]);
    }
  }
  count_ += mask.empty() ? plane : plane - static_cast<std::size_t>(std::count(mask.begin(), mask.end(), 0));
}

void RangeMeasure::add(const Tensor& tensor, std::span<const std::uint8_t> mask) {
  if (tensor.shape.empty() || tensor.shape[0] != static_cast<std::int64_t>(channels_.size())) {
    throw_invalid_argument("a range of " + std::to_string(channels_.size()) + " channels: a tensor with others");
  }
  add(std::span<const float>(tensor.values), mask);
}

void RangeMeasure::add(const FrameFeatures& features) {
  if (channels_.size() != kFrameChannels) throw_internal("a range of nine channels is needed for features");
  for (Eigen::Index v = 0; v < features.rows(); ++v) {
    for (std::size_t c = 0; c < kFrameChannels; ++c) channels_[c].add(features(v, static_cast<Eigen::Index>(c)));
  }
  count_ += static_cast<std::size_t>(features.rows());
}

void RangeMeasure::merge(const RangeMeasure& other) {
  if (other.channels_.size() != channels_.size()) throw_internal("ranges of different channels");
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    channels_[c].minimum = std::min(channels_[c].minimum, other.channels_[c].minimum);
    channels_[c].maximum = std::max(channels_[c].maximum, other.channels_[c].maximum);
    channels_[c].sum += other.channels_[c].sum;
    channels_[c].squares += other.channels_[c].squares;
  }
  count_ += other.count_;
}

ChannelRanges RangeMeasure::extremes(double margin) const {
  if (count_ == 0) throw Error(ErrorCode::kFailedPrecondition, "a range: nothing to measure");
  ChannelRanges ranges;
  for (const Channel& channel : channels_) {
    const float width = channel.maximum - channel.minimum;
    const float extra = static_cast<float>(margin) * width;
    ranges.offset.push_back(channel.minimum - extra);
    ranges.scale.push_back(width + 2 * extra);
  }
  return ranges;
}

ChannelRanges RangeMeasure::moments() const {
  if (count_ == 0) throw Error(ErrorCode::kFailedPrecondition, "a range: nothing to measure");
  ChannelRanges ranges;
  const auto count = static_cast<double>(count_);
  for (const Channel& channel : channels_) {
    const double mean = channel.sum / count;
    const double deviation = std::sqrt(std::max(channel.squares / count - mean * mean, 0.0));
    ranges.offset.push_back(static_cast<float>(mean));
    ranges.scale.push_back(deviation < kSmallestDeviation ? 0.0F : static_cast<float>(deviation));
  }
  return ranges;
}

}  // namespace pleat
