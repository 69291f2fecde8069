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

TEST(SparseCholesky, TheTriangleIsTheFactorOfThePermutedMatrix) {
  for (const int n : {2, 7, 60}) {  // small ones are factorised in another way
    const Eigen::SparseMatrix<double> a = grid_laplacian(n, 4.1);
    const SparseCholesky solver(a);
    const SparseCholesky::Triangle triangle = solver.triangle();
    const Eigen::SparseMatrix<double> product = triangle.lower * triangle.lower.transpose();
    ASSERT_EQ(triangle.permutation.size(), static_cast<std::size_t>(n * n));
    double worst = 0;
    for (int j = 0; j < n * n; ++j) {
      for (Eigen::SparseMatrix<double>::InnerIterator entry(product, j); entry; ++entry) {
        const double expected = a.coeff(triangle.permutation[static_cast<std::size_t>(entry.row())],
                                        triangle.permutation[static_cast<std::size_t>(j)]);
        worst = std::max(worst, std::abs(entry.value() - expected));
      }
      EXPECT_EQ(triangle.lower.innerIndexPtr()[triangle.lower.outerIndexPtr()[j]], j);
    }
    EXPECT_LT(worst, 1e-12);
    EXPECT_NEAR(product.sum(), a.sum(), 1e-9);
    const Eigen::VectorXd ones = Eigen::VectorXd::Ones(n * n);
    EXPECT_LT((solver.solve(a * ones) - ones).norm(), 1e-9);  // the solver is still whole
  }
}

TEST(SparseCholesky, RefusesAnIndefiniteMatrix) { EXPECT_THROW(SparseCholesky(grid_laplacian(5, -1)), Error); }

}  // namespace
}  // namespace pleat
