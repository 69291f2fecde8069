// Order statistics of measured times, and decibels.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace pleat {

/// Quantile q in [0, 1], linear between order statistics; 0 of nothing.
inline double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const double place = q * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

inline double median(std::vector<double> values) { return quantile(std::move(values), 0.5); }

/// 10 log10(peak^2 / mean square error), dB; infinite for 0.
inline double psnr_db(double mean_square_error, double peak = 1) {
  return mean_square_error > 0 ? 10 * std::log10(peak * peak / mean_square_error)
                               : std::numeric_limits<double>::infinity();
}

}  // namespace pleat
