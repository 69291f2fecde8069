#include "services/superres/training/pairs.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr float kFixedLow = -0.5F;
constexpr float kFixedScale = 32768.0F;  // 65536 steps over a range of 2

std::uint16_t to_fixed(float value) {
  return static_cast<std::uint16_t>(std::clamp(std::nearbyint((value - kFixedLow) * kFixedScale), 0.0F, 65535.0F));
}

float from_fixed(std::uint16_t value) { return static_cast<float>(value) / kFixedScale + kFixedLow; }

}  // namespace

void ImageStore::reserve(std::size_t images) {
  const std::size_t values = images * image_values();
  if (fixed_point_) {
    fixed_.reserve(values);
  } else {
    float_.reserve(values);
  }
}

void ImageStore::append(std::span<const float> image) {
  if (image.size() != image_values() || mapped_) throw_internal("image store: image of another size, or not its own");
  if (fixed_point_) {
    std::transform(image.begin(), image.end(), std::back_inserter(fixed_), to_fixed);
  } else {
    float_.insert(float_.end(), image.begin(), image.end());
  }
  ++count_;
}

const void* ImageStore::data() const {
  if (mapped_) return mapped_.get();
  if (fixed_point_) return fixed_.data();
  return float_.data();
}

void ImageStore::read(std::size_t index, int row, int column, int height, int width, float* target) const {
  const auto stride = static_cast<std::size_t>(width_);
  const std::size_t plane = stride * static_cast<std::size_t>(height_);
  const auto* fixed = static_cast<const std::uint16_t*>(data());
  const auto* exact = static_cast<const float*>(data());
  for (std::size_t c = 0; c < kChannels; ++c) {
    for (int r = 0; r < height; ++r) {
      const std::size_t first = (index * kChannels + c) * plane + static_cast<std::size_t>(row + r) * stride +
                                static_cast<std::size_t>(column);
      const std::size_t last = first + static_cast<std::size_t>(width);
      if (fixed_point_) {
        for (std::size_t i = first; i < last; ++i) *target++ = from_fixed(fixed[i]);
      } else {
        target = std::copy(exact + first, exact + last, target);
      }
    }
  }
}

std::size_t PairData::training_frames() const {
  std::size_t frames = 0;
  for (const auto& sequence : sequences) frames += sequence.validation ? 0 : sequence.coarse.size();
  return frames;
}

void PairData::check() const {
  if (training_frames() == 0) throw_invalid_argument("data set: no training frames");
  const ImageStore& first = sequences.front().coarse;
  for (const auto& s : sequences) {
    if (s.coarse.size() == 0 || s.coarse.size() != s.fine.size() || s.coarse.size() != s.rotations.size()) {
      throw_invalid_argument("data set: sequence " + s.name + " has no frames, or not as many coarse as fine ones");
    }
    if (s.coarse.height() != first.height() || s.coarse.width() != first.width() ||
        s.fine.height() != kScale * first.height() || s.fine.width() != kScale * first.width()) {
      throw_invalid_argument("data set: sequence " + s.name + " has images of another size");
    }
  }
  if (fine_mask.size() != static_cast<std::size_t>(kScale * kScale * first.height() * first.width())) {
    throw_invalid_argument("data set: the valid mask has another size than the fine images");
  }
  if (std::none_of(fine_mask.begin(), fine_mask.end(), [](auto m) { return m != 0; })) {
    throw_invalid_argument("data set: no fine texel is valid");
  }
}

}  // namespace pleat::superres
