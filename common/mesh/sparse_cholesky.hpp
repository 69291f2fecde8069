// One factorisation of a symmetric positive definite matrix, many solves: CHOLMOD where it is present, else Eigen.
#pragma once

#include <Eigen/SparseCore>
#include <memory>
#include <vector>

namespace pleat {

class SparseCholesky {
 public:
  /// matrix: (n x n), both triangles stored; only the lower one is read. Throws kInvalidArgument if it is not positive
  /// definite.
  explicit SparseCholesky(const Eigen::SparseMatrix<double>& matrix);
  ~SparseCholesky();
  SparseCholesky(SparseCholesky&&) noexcept;
  SparseCholesky& operator=(SparseCholesky&&) noexcept;

  /// Solves for all columns of right (n x k). May be called from several threads.
  Eigen::MatrixXd solve(const Eigen::MatrixXd& right) const;

  /// A copy of the factor, for solvers of other kinds: lower lower^T = P A P^T, columns with ascending rows, the
  /// diagonal first. Row i of `lower` belongs to row permutation[i] of the matrix.
  struct Triangle {
    Eigen::SparseMatrix<double> lower;
    std::vector<int> permutation;
  };
  Triangle triangle() const;

 private:
  struct Factor;
  std::unique_ptr<Factor> factor_;
};

}  // namespace pleat
