#include "services/conversion/normalization.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "common/base/error.hpp"

namespace pleat {
namespace {

std::size_t channel_size(const Tensor& tensor) {
  if (tensor.shape.empty() || tensor.shape[0] <= 0 ||
      tensor.values.size() % static_cast<std::size_t>(tensor.shape[0]) != 0) {
    throw_invalid_argument("normalisation: a tensor without channels");
  }
  return tensor.values.size() / static_cast<std::size_t>(tensor.shape[0]);
}

void check(const Tensor& tensor, const Normalization& n) {
  const auto channels = static_cast<std::size_t>(tensor.shape.empty() ? 0 : tensor.shape[0]);
  if (n.minimum.size() != channels || n.maximum.size() != channels) {
    throw_invalid_argument("normalisation: ranges for " + std::to_string(n.minimum.size()) + " channels, tensor of " +
                           std::to_string(channels));
  }
  for (std::size_t c = 0; c < channels; ++c) {
    if (!std::isfinite(n.minimum[c]) || !std::isfinite(n.maximum[c]) || n.maximum[c] < n.minimum[c]) {
      throw_invalid_argument("normalisation: the range of channel " + std::to_string(c) + " is not finite or inverted");
    }
  }
}

}  // namespace

void extend_normalization(Normalization& n, const Tensor& tensor, std::span<const std::uint8_t> mask) {
  const std::size_t size = channel_size(tensor);
  const auto channels = static_cast<std::size_t>(tensor.shape[0]);
  if (n.minimum.empty() && n.maximum.empty()) {
    n.minimum.assign(channels, std::numeric_limits<float>::max());
    n.maximum.assign(channels, std::numeric_limits<float>::lowest());
  }
  if (n.minimum.size() != channels || n.maximum.size() != channels || (!mask.empty() && mask.size() != size)) {
    throw_invalid_argument("normalisation: channels or mask do not belong to the tensor");
  }
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t i = 0; i < size; ++i) {
      if (!mask.empty() && mask[i] == 0) continue;
      n.minimum[c] = std::min(n.minimum[c], tensor.values[c * size + i]);
      n.maximum[c] = std::max(n.maximum[c], tensor.values[c * size + i]);
    }
  }
}

std::size_t normalize(Tensor& tensor, const Normalization& n) {
  const std::size_t size = channel_size(tensor);
  check(tensor, n);
  std::size_t outside = 0;
  for (std::size_t c = 0; c < n.minimum.size(); ++c) {
    const float range = n.maximum[c] - n.minimum[c];
    // Division, because the maximum must become exactly 1.
    const float divisor = range > 0 ? range : 1;
    const float shift = range > 0 ? 0 : 0.5f;
    for (std::size_t i = c * size; i < (c + 1) * size; ++i) {
      float& value = tensor.values[i];
      value = (value - n.minimum[c]) / divisor + shift;
      outside += !(value >= 0 && value <= 1);
    }
  }
  return outside;
}

void denormalize(Tensor& tensor, const Normalization& n) {
  const std::size_t size = channel_size(tensor);
  check(tensor, n);
  for (std::size_t c = 0; c < n.minimum.size(); ++c) {
    const float range = n.maximum[c] - n.minimum[c];
    const float scale = range > 0 ? range : 1;
    const float shift = range > 0 ? 0 : 0.5f;
    for (std::size_t i = c * size; i < (c + 1) * size; ++i) {
      tensor.values[i] = (tensor.values[i] - shift) * scale + n.minimum[c];
    }
  }
}

}  // namespace pleat
