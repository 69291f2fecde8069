// Features scaled to [0, 1] per channel, with the range of the training split (docs/file-formats.md, /normalization).
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "common/frame/frame.hpp"

namespace pleat {

/// One range per channel; the same for coarse and fine images.
struct Normalization {
  std::vector<float> minimum;
  std::vector<float> maximum;
};

/// Grows the range over the texels whose mask is not 0 (an empty mask: all). An empty normalisation starts a new one.
/// Throws kInvalidArgument if the channel counts or the mask's size differ.
void extend_normalization(Normalization& normalization, const Tensor& tensor, std::span<const std::uint8_t> mask = {});

/// value -> (value - minimum) / (maximum - minimum), in place. Returns how many values are outside [0, 1]; they are
/// kept, never clipped. A channel whose range is empty maps to value - minimum + 0.5. Throws kInvalidArgument if the
/// channel counts differ or a range is not finite or inverted.
std::size_t normalize(Tensor& tensor, const Normalization& normalization);

/// The inverse, in place.
void denormalize(Tensor& tensor, const Normalization& normalization);

}  // namespace pleat
