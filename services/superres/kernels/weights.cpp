#include "services/superres/kernels/weights.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <new>

namespace pleat::superres::kernels {
namespace {

constexpr std::align_val_t kAlignment{64};

/// Calls use(output, input, its taps).
template <typename Use>
void for_weights(std::span<const float> weight, std::size_t inputs, std::size_t taps, const Use& use) {
  const std::size_t outputs = weight.size() / (inputs * taps);
  const float* w = weight.data();
  for (std::size_t o = 0; o < outputs; ++o) {
    for (std::size_t i = 0; i < inputs; ++i, w += taps) use(static_cast<int>(o), i, w);
  }
}

/// Weights of a 1x1 convolution, in the kernels' blocks, from (k, n).
void pack1(const Kernels& kernels, const float* taps, int k, int n, void* target) {
  const auto depth = static_cast<std::size_t>(k), columns = static_cast<std::size_t>(n);
  const auto block = static_cast<std::size_t>(kernels.block), lanes = static_cast<std::size_t>(kernels.lanes);
  alignas(64) float values[16];
  alignas(64) std::uint16_t halves[16];
  for (std::size_t i = 0; i < depth; ++i) {
    for (std::size_t j = 0; j < columns; j += lanes) {
      const std::size_t first = j / block * block, width = std::min(block, columns - first);
      if (kernels.element == 4) {
        std::memcpy(static_cast<float*>(target) + first * depth + i * width + j - first, &taps[i * columns + j],
                    lanes * sizeof(float));
        continue;
      }
      std::copy_n(&taps[i * columns + j], lanes, values);
      kernels.store(values, halves, kernels.lanes);
      auto* place = static_cast<std::uint16_t*>(target) + first * depth + (i / 2 * width + j - first) * 2 + i % 2;
      for (std::size_t l = 0; l < lanes; ++l) place[2 * l] = halves[l];
    }
  }
}

}  // namespace

Buffer::Buffer(std::size_t bytes) : data_(::operator new(std::max<std::size_t>(bytes, 64), kAlignment)) {
  std::memset(data_.get(), 0, std::max<std::size_t>(bytes, 64));
}

void Buffer::Free::operator()(void* memory) const noexcept { ::operator delete(memory, kAlignment); }

int round_up(int value, int multiple) { return (value + multiple - 1) / multiple * multiple; }

Taps::Taps(int kernel, int k, int n) : kernel_(kernel), k_(k), n_(n), values_(times(kernel, kernel) * times(k, n)) {}

void Taps::put(std::span<const float> weight, std::span<const int> inputs) {
  const std::size_t taps = times(kernel_, kernel_);
  for_weights(weight, inputs.size(), taps, [&](int o, std::size_t i, const float* w) {
    for (std::size_t t = 0; t < taps; ++t) *at(t, inputs[i], o) = w[t];
  });
}

void Taps::put_turned(std::span<const float> weight, std::span<const int> inputs, int row, int first) {
  const std::size_t taps = times(kernel_, kernel_);
  for_weights(weight, inputs.size(), taps, [&](int o, std::size_t i, const float* w) {
    const int column = inputs[i] - first;
    if (column < 0 || column >= n_) return;
    for (std::size_t t = 0; t < taps; ++t) *at(taps - 1 - t, row + o, column) = w[t];
  });
}

void Taps::pack(const Kernels& kernels, const Buffer& target) const {
  // The kernels read whole vectors.
  const Buffer aligned(values_.size() * sizeof(float));
  std::copy(values_.begin(), values_.end(), aligned.floats());
  if (kernel_ == 3) {
    kernels.pack3(aligned.floats(), k_, n_, target.data());
  } else {
    pack1(kernels, aligned.floats(), k_, n_, target.data());
  }
}

std::size_t Taps::packed_bytes(const Kernels& kernels, int kernel, int k, int n) {
  return (kernel == 3 ? kPoints : 1) * times(k, n) * static_cast<std::size_t>(kernels.element);
}

}  // namespace pleat::superres::kernels
