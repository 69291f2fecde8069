#include <gtest/gtest.h>

#include <random>
#include <thread>

#include "common/base/error.hpp"
#include "common/mesh/sparse_cholesky.hpp"

namespace pleat {
namespace {

Eigen::SparseMatrix<double> grid_laplacian(int n, double diagonal) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int i = 0; i < n * n; ++i) {
    entries.emplace_back(i, i, diagonal);
    for (const int j : {i % n + 1 < n ? i + 1 : -1, i + n < n * n ? i + n : -1}) {
      if (j < 0) continue;
      entries.emplace_back(i, j, -1);
      entries.emplace_back(j, i, -1);
    }
  }
  Eigen::SparseMatrix<double> matrix(n * n, n * n);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

TEST(SparseCholesky, SolvesManyRightSidesFromTwoThreads) {
  const Eigen::SparseMatrix<double> a = grid_laplacian(40, 4.5);
  const SparseCholesky solver(a);
  EXPECT_EQ(solver.size(), 1600);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const Eigen::MatrixXd x =
      Eigen::MatrixXd::NullaryExpr(1600, 5, [&](Eigen::Index, Eigen::Index) { return uniform(random); });
  Eigen::MatrixXd first, second;
  std::thread other([&] { second = solver.solve(a * x); });
  first = solver.solve(a * x);
  other.join();
  EXPECT_LT((first - x).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_LT((second - x).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(SparseCholesky, RefusesAnIndefiniteMatrix) { EXPECT_THROW(SparseCholesky(grid_laplacian(5, -1)), Error); }

}  // namespace
}  // namespace pleat
