// Checks of arrays that others sent. Messages begin with the field's name as the caller gives it ("open.coarse.faces").
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "common/base/error.hpp"

namespace pleat {

/// kResourceExhausted if there are more values than `limit`.
inline void check_limit(std::size_t count, std::size_t limit, const std::string& field) {
  if (count <= limit) return;
  throw Error(ErrorCode::kResourceExhausted,
              field + ": " + std::to_string(count) + " values, at most " + std::to_string(limit));
}

/// kInvalidArgument unless the values make whole rows.
inline void check_rows(std::size_t count, std::size_t columns, const std::string& field) {
  if (count % columns == 0) return;
  throw_invalid_argument(field + ": " + std::to_string(count) + " values, not a multiple of " +
                         std::to_string(columns));
}

/// No NaN and no infinity among the values. O(n); as integers, whose largest one is found several at a time, while
/// floating-point sums and searches that may end early go one by one: ten times as fast.
inline bool all_finite(std::span<const float> values) {
  constexpr std::uint32_t kWithoutSign = 0x7fffffff, kInfinity = 0x7f800000;
  std::uint32_t largest = 0;
  for (const float value : values) largest = std::max(largest, std::bit_cast<std::uint32_t>(value) & kWithoutSign);
  return largest < kInfinity;
}

/// The same of a dense matrix, of all its entries.
template <typename Matrix>
requires requires(const Matrix& matrix) { matrix.rows(); }
bool all_finite(const Matrix& matrix) {
  return all_finite(std::span<const float>(matrix.data(), static_cast<std::size_t>(matrix.size())));
}

/// kInvalidArgument for NaN and infinities; the first is named. O(n), fast where all is well.
inline void check_finite(std::span<const float> values, const std::string& field) {
  if (all_finite(values)) return;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) throw_invalid_argument(field + ": value " + std::to_string(i) + " is not finite");
  }
}

/// kInvalidArgument for an index that is not below `count`; the first is named.
inline void check_indices(std::span<const std::uint32_t> indices, std::size_t count, const std::string& field) {
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] >= count) {
      throw_invalid_argument(field + ": index " + std::to_string(indices[i]) + " at " + std::to_string(i) +
                             ", but there are " + std::to_string(count));
    }
  }
}

}  // namespace pleat
