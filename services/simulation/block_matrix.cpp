#include "services/simulation/block_matrix.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace pleat::simulation {

BlockMatrix::BlockMatrix(std::size_t vertices, std::span<const std::pair<std::uint32_t, std::uint32_t>> pairs) {
  struct Entry {
    std::uint32_t row, column, pair;
    bool upper;
  };
  std::vector<Entry> entries;
  entries.reserve(2 * pairs.size());
  for (std::size_t p = 0; p < pairs.size(); ++p) {
    entries.push_back({pairs[p].first, pairs[p].second, static_cast<std::uint32_t>(p), true});
    entries.push_back({pairs[p].second, pairs[p].first, static_cast<std::uint32_t>(p), false});
  }
  std::sort(entries.begin(), entries.end(),
            [](const Entry& a, const Entry& b) { return a.row < b.row || (a.row == b.row && a.column < b.column); });
  offsets_.assign(vertices + 1, 0);
  columns_.resize(entries.size());
  slots_.resize(pairs.size());
  for (std::size_t e = 0; e < entries.size(); ++e) {
    ++offsets_[entries[e].row + 1];
    columns_[e] = entries[e].column;
    (entries[e].upper ? slots_[entries[e].pair].first : slots_[entries[e].pair].second) = static_cast<std::uint32_t>(e);
  }
  std::partial_sum(offsets_.begin(), offsets_.end(), offsets_.begin());
  values_.assign(9 * entries.size() + 1, 0);
  diagonal_.assign(9 * vertices + 1, 0);
}

void invert_block(const float* b, float* inverse) {
  const double a00 = b[0], a10 = b[1], a20 = b[2], a11 = b[4], a21 = b[5], a22 = b[8];
  const double c00 = a11 * a22 - a21 * a21, c10 = a20 * a21 - a10 * a22, c20 = a10 * a21 - a20 * a11;
  const double determinant = a00 * c00 + a10 * c10 + a20 * c20;
  const double scale = determinant > 0 && std::isfinite(determinant) ? 1 / determinant : 0;
  const double i00 = c00 * scale, i10 = c10 * scale, i20 = c20 * scale;
  const double i11 = (a00 * a22 - a20 * a20) * scale, i21 = (a10 * a20 - a00 * a21) * scale;
  const double i22 = (a00 * a11 - a10 * a10) * scale;
  const double values[9] = {i00, i10, i20, i10, i11, i21, i20, i21, i22};
  for (int k = 0; k < 9; ++k) inverse[k] = static_cast<float>(values[k]);
}

}  // namespace pleat::simulation
