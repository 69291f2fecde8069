// Trained weights in the order that the kernels read.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "services/superres/cpu/kernels.hpp"

namespace pleat::superres::cpu {

/// Zeroed memory, aligned to 64 bytes.
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(std::size_t bytes);

  void* data() const { return data_.get(); }
  float* floats() const { return static_cast<float*>(data_.get()); }
  /// Byte address of an element of a given size.
  void* at(std::size_t index, int element) const {
    return static_cast<char*>(data_.get()) + index * static_cast<std::size_t>(element);
  }

 private:
  struct Free {
    void operator()(void* memory) const noexcept;
  };
  std::unique_ptr<void, Free> data_;
};

int round_up(int value, int multiple);

struct Weights {
  int k = 0, n = 0;  ///< as in ConvolutionCall
  Buffer weights, bias;
};

/// Packs a convolution. weight: (out, in, kernel, kernel) row-major, kernel 3 or 1; bias: (out) or empty for zeros.
/// Input channel i is read from channel places[i] of k (in ascending order, the others count as zero). Output channels
/// are padded with zeros to a multiple of the kernels' lanes.
Weights pack_weights(const Kernels& kernels, std::span<const float> weight, std::span<const float> bias, int kernel,
                     std::span<const int> places, int k);

}  // namespace pleat::superres::cpu
