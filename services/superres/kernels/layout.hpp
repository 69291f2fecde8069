// Where a network's values lie in memory, so that a convolution finds the channels of all its inputs side by side.
//
// A dense block reads [f], [f, a1], [f, a1, a2], ...: one image, the stack, that grows. A value that is read in two
// lists of different order lies in two stacks. Channels are padded to whole vectors.
#pragma once

#include <vector>

#include "services/superres/kernels/kernels.hpp"
#include "services/superres/networks/description.hpp"

namespace pleat::superres::kernels {

/// Channels of an image, from `first` on.
struct Place {
  int image = -1;
  int first = 0;
  bool exists() const { return image >= 0; }
};

struct ImageLayout {
  int size = 0;      ///< in Layout::sizes
  int channels = 0;  ///< padded: its stride
  int element = 4;   ///< bytes
  std::vector<int> values;
  int written = 0;    ///< by the layer that makes its first value
  int last_read = 0;  ///< by the last layer that reads one of its values
};

struct ValueLayout {
  int channels = 0, padded = 0;
  int size = 0;               ///< in Layout::sizes
  std::vector<Place> places;  ///< wherever it is read from
  Place floats;               ///< one of float32: for sums, resampling and the answer; may not exist
};

/// What a convolution reads.
struct ReadLayout {
  Place from;
  int k = 0;                  ///< padded channels side by side
  std::vector<int> channels;  ///< of its inputs, counted from `from`
  /// Transformed tiles of the whole image are kept for the later layers that read it too; the channels before this one
  /// are there already. Else -1: a few rows of tiles at a time.
  int transform_from = -1;
};

struct Layout {
  /// element_bytes: of the layers that are not exact.
  Layout(const Description& network, Size input, int lanes, int element_bytes);

  const ValueLayout& value(int index) const { return values[static_cast<std::size_t>(index)]; }
  const ImageLayout& image(const Place& place) const { return images[static_cast<std::size_t>(place.image)]; }

  int element;
  std::vector<Size> sizes;  ///< that occur
  std::vector<ValueLayout> values;
  std::vector<ImageLayout> images;
  std::vector<ReadLayout> reads;  ///< one a layer
};

}  // namespace pleat::superres::kernels
