// Symmetric sparse matrix of 3x3 blocks with a fixed pattern, and the conjugate gradients on it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/base/simd.hpp"
#include "common/mesh/connectivity.hpp"

namespace pleat::simulation {

/// Vertices are handled in ranges of this many, whatever the number of threads: sums are added in range order.
inline constexpr std::size_t kVertexGrain = 1024;

/// Float blocks, column-major, 9 floats each. Every off-diagonal pair is stored in both rows.
class BlockMatrix {
 public:
  BlockMatrix() = default;
  /// pairs: the off-diagonal blocks (i < j), each once. O(n + m log m).
  BlockMatrix(std::size_t vertices, std::span<const std::pair<std::uint32_t, std::uint32_t>> pairs);

  std::size_t size() const { return offsets_.size() - 1; }

  /// Where pair p (in the constructor's order) is stored: its block in row i and the transposed one in row j.
  std::uint32_t upper_slot(std::size_t p) const { return slots_[p].first; }
  std::uint32_t lower_slot(std::size_t p) const { return slots_[p].second; }

  float* block(std::uint32_t slot) { return values_.data() + 9 * static_cast<std::size_t>(slot); }
  const float* block(std::uint32_t slot) const { return values_.data() + 9 * static_cast<std::size_t>(slot); }
  float* diagonal(std::size_t i) { return diagonal_.data() + 9 * i; }
  const float* diagonal(std::size_t i) const { return diagonal_.data() + 9 * i; }
  std::uint32_t row_begin(std::size_t i) const { return offsets_[i]; }
  std::uint32_t row_end(std::size_t i) const { return offsets_[i + 1]; }
  std::uint32_t column(std::uint32_t slot) const { return columns_[slot]; }

  /// The off-diagonal block (i, j), kNone if the pattern has none. O(log of the row).
  std::uint32_t find(std::uint32_t i, std::uint32_t j) const {
    const auto begin = columns_.begin() + offsets_[i], end = columns_.begin() + offsets_[i + 1];
    const auto found = std::lower_bound(begin, end, j);
    return found != end && *found == j ? static_cast<std::uint32_t>(found - columns_.begin()) : kNone;
  }

  /// Row i of A x.
  Float4 multiply_row(std::size_t i, const Float4* x) const {
    Float4 sum = apply(diagonal(i), x[i]);
    for (std::uint32_t slot = offsets_[i]; slot < offsets_[i + 1]; ++slot) sum += apply(block(slot), x[columns_[slot]]);
    return sum;
  }

  /// block * x.
  static Float4 apply(const float* block, Float4 x) {
    return load(block) * x[0] + load(block + 3) * x[1] + load(block + 6) * x[2];
  }

  /// A column of a block. Reads one float past it; the arrays are padded for the last one.
  static Float4 load(const float* column) {
    Float4 v;
    __builtin_memcpy(&v, column, sizeof(v));
    return v;
  }
  /// Writes the three columns of a block, and nothing beyond it.
  static void store(float* block, Float4 c0, Float4 c1, Float4 c2) {
    __builtin_memcpy(block, &c0, sizeof(c0));
    __builtin_memcpy(block + 3, &c1, sizeof(c1));
    __builtin_memcpy(block + 6, &c2, 3 * sizeof(float));
  }

 private:
  std::vector<std::uint32_t> offsets_{0};
  std::vector<std::uint32_t> columns_;
  std::vector<float> values_;
  std::vector<float> diagonal_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> slots_;
};

/// Inverse of a symmetric positive definite 3x3 block; zero if it is not invertible.
void invert_block(const float* block, float* inverse);

}  // namespace pleat::simulation
