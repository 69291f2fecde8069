#include "services/conversion/vertex_features/factor.hpp"

#include <gtest/gtest.h>

#include "services/conversion/vertex_features/one_rings.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

TEST(LaneFactor, SolvesAsTheFactorItCopies) {
  const auto rings = test::rings_of(test::sheet(17, 12, 0.1f));
  const auto count = static_cast<Eigen::Index>(rings->vertex_count());
  Eigen::SparseMatrix<double> matrix(count, count);
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index v = 0; v < count; ++v) entries.emplace_back(v, v, 0.01);
  for (const auto& e : rings->edges()) {
    const auto w = static_cast<double>(e.weight);
    entries.insert(entries.end(), {{static_cast<int>(e.a), static_cast<int>(e.a), w},
                                   {static_cast<int>(e.b), static_cast<int>(e.b), w},
                                   {static_cast<int>(e.a), static_cast<int>(e.b), -w},
                                   {static_cast<int>(e.b), static_cast<int>(e.a), -w}});
  }
  matrix.setFromTriplets(entries.begin(), entries.end());
  const SparseCholesky cholesky(matrix);
  const SparseCholesky::Triangle triangle = cholesky.triangle();
  const Eigen::MatrixXd right = Eigen::MatrixXd::Random(count, 3), expected = cholesky.solve(right);
  std::vector<Double4> x(static_cast<std::size_t>(count));
  for (std::size_t k = 0; k < x.size(); ++k) {
    const int row = triangle.permutation[k];
    x[k] = Double4{right(row, 0), right(row, 1), right(row, 2), 0};
  }
  LaneFactor(triangle).solve(x);
  for (std::size_t k = 0; k < x.size(); ++k) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(x[k][c], expected(triangle.permutation[k], c), 1e-9);
  }
}

}  // namespace
}  // namespace pleat::conversion
