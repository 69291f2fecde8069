// Substitution with a sparse Cholesky factor for three right-hand sides at once, one register a row. Internal.
#pragma once

#include <cstdint>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/sparse_cholesky.hpp"

namespace pleat::conversion {

class LaneFactor {
 public:
  /// Copies the factor. Row i of the substitution is row triangle.permutation[i] of the matrix.
  explicit LaneFactor(const SparseCholesky::Triangle& triangle);

  /// x = A^-1 x in place, x: (n) in the order of the permutation.
  void solve(std::vector<Double4>& x) const;

 private:
  std::vector<std::uint32_t> offsets_;  // (n + 1) into rows_
  std::vector<std::uint32_t> rows_;     // below the diagonal, by columns
  std::vector<double> values_;
  std::vector<double> inverse_diagonal_;
};

}  // namespace pleat::conversion
