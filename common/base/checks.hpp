// Checks of arrays that others sent. Messages begin with the field's name as the caller gives it ("open.coarse.faces").
#pragma once

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

/// kInvalidArgument for NaN and infinities; the first is named. O(n), without branches where all is well.
inline void check_finite(std::span<const float> values, const std::string& field) {
  // A sum of zeros is zero; a NaN or an infinity times zero is a NaN.
  float sum = 0;
  for (const float value : values) sum += value * 0.0f;
  if (sum == 0.0f) return;
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
