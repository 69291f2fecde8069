#include "services/conversion/vertex_features/factor.hpp"

namespace pleat::conversion {

LaneFactor::LaneFactor(const SparseCholesky::Triangle& triangle) {
  const Eigen::SparseMatrix<double>& lower = triangle.lower;
  offsets_.push_back(0);
  for (Eigen::Index column = 0; column < lower.cols(); ++column) {
    Eigen::SparseMatrix<double>::InnerIterator entry(lower, column);
    inverse_diagonal_.push_back(1 / entry.value());
    for (++entry; entry; ++entry) {
      rows_.push_back(static_cast<std::uint32_t>(entry.row()));
      values_.push_back(entry.value());
    }
    offsets_.push_back(static_cast<std::uint32_t>(rows_.size()));
  }
}

void LaneFactor::solve(std::vector<Double4>& x) const {
  const std::size_t size = inverse_diagonal_.size();
  const std::uint32_t* const rows = rows_.data();
  const double* const values = values_.data();
  Double4* const to = x.data();
  for (std::size_t column = 0; column < size; ++column) {
    const Double4 known = to[column] * inverse_diagonal_[column];
    to[column] = known;
    for (std::uint32_t k = offsets_[column]; k < offsets_[column + 1]; ++k) to[rows[k]] -= values[k] * known;
  }
  for (std::size_t column = size; column-- > 0;) {
    // Four sums: one would wait for every product before it.
    Double4 sums[4] = {to[column], Double4{}, Double4{}, Double4{}};
    std::uint32_t k = offsets_[column];
    const std::uint32_t end = offsets_[column + 1];
    for (; k + 4 <= end; k += 4) {
      for (std::uint32_t lane = 0; lane < 4; ++lane) sums[lane] -= values[k + lane] * to[rows[k + lane]];
    }
    for (; k < end; ++k) sums[0] -= values[k] * to[rows[k]];
    to[column] = ((sums[0] + sums[1]) + (sums[2] + sums[3])) * inverse_diagonal_[column];
  }
}

}  // namespace pleat::conversion
