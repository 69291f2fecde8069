#include "common/mesh/sparse_cholesky.hpp"

#include <cstring>
#include <string>

#include "common/base/error.hpp"

#if PLEAT_HAVE_CHOLMOD
#include <cholmod.h>
#else
#include <Eigen/SparseCholesky>
#endif

namespace pleat {

#if PLEAT_HAVE_CHOLMOD

namespace {

// A solve writes to its cholmod_common, so every call has its own and the factor itself is only read.
struct Common {
  cholmod_common value;
  Common() {
    cholmod_start(&value);
    value.print = 0;
  }
  ~Common() { cholmod_finish(&value); }
  Common(const Common&) = delete;
  Common& operator=(const Common&) = delete;
};

}  // namespace

struct SparseCholesky::Factor {
  Common common;
  cholmod_factor* factor = nullptr;
  Eigen::Index size = 0;
  ~Factor() { cholmod_free_factor(&factor, &common.value); }
};

SparseCholesky::SparseCholesky(const Eigen::SparseMatrix<double>& matrix) : factor_(std::make_unique<Factor>()) {
  Eigen::SparseMatrix<double> lower = matrix.triangularView<Eigen::Lower>();
  lower.makeCompressed();
  factor_->size = matrix.rows();
  cholmod_sparse a{};
  a.nrow = static_cast<std::size_t>(lower.rows());
  a.ncol = static_cast<std::size_t>(lower.cols());
  a.nzmax = static_cast<std::size_t>(lower.nonZeros());
  a.p = lower.outerIndexPtr();
  a.i = lower.innerIndexPtr();
  a.x = lower.valuePtr();
  a.stype = -1;
  a.itype = CHOLMOD_INT;
  a.xtype = CHOLMOD_REAL;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = 1;
  a.packed = 1;
  cholmod_common* common = &factor_->common.value;
  factor_->factor = cholmod_analyze(&a, common);
  if (factor_->factor == nullptr || !cholmod_factorize(&a, factor_->factor, common) || common->status != CHOLMOD_OK) {
    throw_invalid_argument("sparse Cholesky: the matrix of size " + std::to_string(matrix.rows()) +
                           " is not positive definite, or memory is short");
  }
}

Eigen::MatrixXd SparseCholesky::solve(const Eigen::MatrixXd& right) const {
  if (right.rows() != factor_->size) throw_internal("sparse Cholesky: right side of another size");
  Common common;
  cholmod_dense b{};
  b.nrow = static_cast<std::size_t>(right.rows());
  b.ncol = static_cast<std::size_t>(right.cols());
  b.nzmax = b.nrow * b.ncol;
  b.d = b.nrow;
  b.x = const_cast<double*>(right.data());
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_->factor, &b, &common.value);
  if (x == nullptr) throw_internal("sparse Cholesky: no memory for a solve");
  Eigen::MatrixXd result(right.rows(), right.cols());
  std::memcpy(result.data(), x->x, sizeof(double) * b.nzmax);
  cholmod_free_dense(&x, &common.value);
  return result;
}

SparseCholesky::Triangle SparseCholesky::triangle() const {
  Common common;
  cholmod_factor* copy = cholmod_copy_factor(factor_->factor, &common.value);
  // Simplicial, packed, sorted columns of L L^T whatever kind of factor was chosen.
  if (copy == nullptr || !cholmod_change_factor(CHOLMOD_REAL, 1, 0, 1, 1, copy, &common.value)) {
    throw_internal("sparse Cholesky: no memory for a copy of the factor");
  }
  Triangle triangle;
  const auto* permutation = static_cast<const int*>(copy->Perm);
  triangle.permutation.assign(permutation, permutation + factor_->size);
  cholmod_sparse* sparse = cholmod_factor_to_sparse(copy, &common.value);
  cholmod_free_factor(&copy, &common.value);
  if (sparse == nullptr) throw_internal("sparse Cholesky: no memory for a copy of the factor");
  const auto size = static_cast<Eigen::Index>(sparse->nrow);
  triangle.lower = Eigen::Map<const Eigen::SparseMatrix<double>>(
      size, size, static_cast<const int*>(sparse->p)[size], static_cast<const int*>(sparse->p),
      static_cast<const int*>(sparse->i), static_cast<const double*>(sparse->x));
  cholmod_free_sparse(&sparse, &common.value);
  return triangle;
}

#else

struct SparseCholesky::Factor {
  Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> llt;
};

SparseCholesky::SparseCholesky(const Eigen::SparseMatrix<double>& matrix) : factor_(std::make_unique<Factor>()) {
  factor_->llt.compute(matrix);
  if (factor_->llt.info() != Eigen::Success) {
    throw_invalid_argument("sparse Cholesky: the matrix of size " + std::to_string(matrix.rows()) +
                           " is not positive definite");
  }
}

Eigen::MatrixXd SparseCholesky::solve(const Eigen::MatrixXd& right) const {
  if (right.rows() != factor_->llt.rows()) throw_internal("sparse Cholesky: right side of another size");
  return factor_->llt.solve(right);
}

SparseCholesky::Triangle SparseCholesky::triangle() const {
  Triangle triangle;
  triangle.lower = factor_->llt.matrixL();
  // permutationP() maps a row of the matrix to its place in the factor.
  triangle.permutation.resize(static_cast<std::size_t>(size()));
  for (int row = 0; row < static_cast<int>(size()); ++row) {
    triangle.permutation[static_cast<std::size_t>(factor_->llt.permutationP().indices()(row))] = row;
  }
  return triangle;
}

#endif

SparseCholesky::~SparseCholesky() = default;
SparseCholesky::SparseCholesky(SparseCholesky&&) noexcept = default;
SparseCholesky& SparseCholesky::operator=(SparseCholesky&&) noexcept = default;

}  // namespace pleat
