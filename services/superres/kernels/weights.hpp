// Trained weights in the order that the kernels read.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "services/superres/kernels/kernels.hpp"

namespace pleat::superres::kernels {

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

inline std::size_t times(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

/// Weights on their way to the kernels' order: (kernel^2, k, n), zero where nothing was put.
class Taps {
 public:
  Taps(int kernel, int k, int n);

  /// weight: (out, in, kernel, kernel), of which input i is channel inputs[i] of k.
  void put(std::span<const float> weight, std::span<const int> inputs);
  /// For the gradient of the inputs that lie in [first, first + n): outputs become rows from `row` on, and a 3x3 kernel
  /// turns by half a circle.
  void put_turned(std::span<const float> weight, std::span<const int> inputs, int row, int first);

  /// Brings them into `target`, of packed_bytes().
  void pack(const Kernels& kernels, const Buffer& target) const;
  static std::size_t packed_bytes(const Kernels& kernels, int kernel, int k, int n);

 private:
  int kernel_, k_, n_;
  std::vector<float> values_;
  float* at(std::size_t tap, int row, int column) {
    return &values_[(tap * static_cast<std::size_t>(k_) + static_cast<std::size_t>(row)) *
                        static_cast<std::size_t>(n_) +
                    static_cast<std::size_t>(column)];
  }
};

}  // namespace pleat::superres::kernels
