#include "services/superres/cpu/weights.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <new>

#include "common/base/error.hpp"

namespace pleat::superres::cpu {
namespace {

constexpr std::align_val_t kAlignment{64};

/// Winograd's transform of a kernel, for points 0, 1, -1, 2, -2 and infinity: 3 weights to 6.
constexpr double kTransform[6][3] = {{1.0 / 4, 0, 0},
                                     {-1.0 / 6, -1.0 / 6, -1.0 / 6},
                                     {-1.0 / 6, 1.0 / 6, -1.0 / 6},
                                     {1.0 / 24, 1.0 / 12, 1.0 / 6},
                                     {1.0 / 24, -1.0 / 12, 1.0 / 6},
                                     {0, 0, 1}};

std::array<double, kPoints> transform_kernel(const float* w) {
  std::array<double, kPoints> result{};
  for (std::size_t y = 0; y < 6; ++y) {
    for (std::size_t x = 0; x < 6; ++x) {
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) result[6 * y + x] += kTransform[y][i] * kTransform[x][j] * w[3 * i + j];
      }
    }
  }
  return result;
}

/// Nearest, ties to even.
std::uint16_t to_bfloat16(float value) { return Eigen::numext::bit_cast<std::uint16_t>(Eigen::bfloat16(value)); }

}  // namespace

Buffer::Buffer(std::size_t bytes) : data_(::operator new(std::max<std::size_t>(bytes, 64), kAlignment)) {
  std::memset(data_.get(), 0, std::max<std::size_t>(bytes, 64));
}

void Buffer::Free::operator()(void* memory) const noexcept { ::operator delete(memory, kAlignment); }

int round_up(int value, int multiple) { return (value + multiple - 1) / multiple * multiple; }

Weights pack_weights(const Kernels& kernels, std::span<const float> weight, std::span<const float> bias, int kernel,
                     std::span<const int> places, int k) {
  const auto inputs = places.size(), taps = static_cast<std::size_t>(kernel * kernel);
  const std::size_t outputs = weight.size() / (inputs * taps);
  if (outputs * inputs * taps != weight.size() || (!bias.empty() && bias.size() != outputs) || k % 2 != 0) {
    throw_internal("weights: sizes contradict each other");
  }
  Weights packed;
  packed.k = k;
  packed.n = round_up(static_cast<int>(outputs), kernels.lanes);
  const auto depth = static_cast<std::size_t>(k), columns = static_cast<std::size_t>(packed.n);
  const std::size_t points = kernel == 3 ? kPoints : 1, block = static_cast<std::size_t>(kernels.block);
  packed.weights = Buffer(points * depth * columns * static_cast<std::size_t>(kernels.element));
  packed.bias = Buffer(columns * sizeof(float));
  std::copy(bias.begin(), bias.end(), packed.bias.floats());
  auto* halves = static_cast<std::uint16_t*>(packed.weights.data());
  for (std::size_t o = 0; o < outputs; ++o) {
    const std::size_t first = o / block * block, width = std::min(block, columns - first);
    for (std::size_t i = 0; i < inputs; ++i) {
      std::array<double, kPoints> values{};
      const float* w = &weight[(o * inputs + i) * taps];
      if (kernel == 3) {
        values = transform_kernel(w);
      } else {
        values[0] = *w;
      }
      const auto row = static_cast<std::size_t>(places[i]);
      for (std::size_t p = 0; p < points; ++p) {
        const std::size_t begin = p * depth * columns + first * depth;
        if (kernels.element == 4) {
          packed.weights.floats()[begin + row * width + o - first] = static_cast<float>(values[p]);
        } else {
          halves[begin + (row / 2 * width + o - first) * 2 + row % 2] = to_bfloat16(static_cast<float>(values[p]));
        }
      }
    }
  }
  return packed;
}

}  // namespace pleat::superres::cpu
