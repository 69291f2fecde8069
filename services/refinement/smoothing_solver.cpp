#include "services/refinement/smoothing_solver.hpp"

#include <algorithm>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/sparse_cholesky.hpp"

namespace pleat::refinement {
namespace {

// L^T L + stand_still I.
Eigen::SparseMatrix<double> smoothing_matrix(const Faces& faces, Eigen::Index vertex_count, double stand_still) {
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const auto a = static_cast<int>(faces(f, k)), b = static_cast<int>(faces(f, (k + 1) % 3));
      entries.emplace_back(a, b, 1);
      entries.emplace_back(b, a, 1);
    }
  }
  Eigen::SparseMatrix<double> laplacian(vertex_count, vertex_count);
  // An edge of two faces counts once.
  laplacian.setFromTriplets(entries.begin(), entries.end(), [](double, double) { return 1.0; });
  const Eigen::VectorXd degree = laplacian * Eigen::VectorXd::Ones(vertex_count);
  laplacian = degree.cwiseMax(1).cwiseInverse().asDiagonal() * laplacian;
  Eigen::SparseMatrix<double> identity(vertex_count, vertex_count);
  identity.setIdentity();
  laplacian = identity - laplacian;
  const Eigen::SparseMatrix<double> bending = laplacian.transpose() * laplacian;
  return bending + stand_still * identity;
}

}  // namespace

SmoothingSolver::SmoothingSolver(const Faces& faces, Eigen::Index vertex_count, double stand_still) {
  const SparseCholesky cholesky(smoothing_matrix(faces, vertex_count, stand_still));
  const SparseCholesky::Triangle triangle = cholesky.triangle();
  const Eigen::SparseMatrix<double>& lower = triangle.lower;
  const auto n = static_cast<std::uint32_t>(lower.cols());
  position_.resize(n);
  for (std::uint32_t i = 0; i < n; ++i) position_[static_cast<std::size_t>(triangle.permutation[i])] = i;

  const auto begin = [&](std::uint32_t column) { return lower.outerIndexPtr()[column]; };
  const auto count = [&](std::uint32_t column) {
    return static_cast<std::uint32_t>(begin(column + 1) - begin(column));
  };
  block_of_.resize(n);
  inverse_diagonal_.resize(n);
  x_.assign(n, Lanes{});
  std::size_t most_rows = 0;
  for (std::uint32_t first = 0; first < n;) {
    // Columns with one pattern, up to the rows that they leave behind, are one block.
    std::uint32_t last = first + 1;
    while (last < n && count(last - 1) == count(last) + 1 &&
           static_cast<std::uint32_t>(lower.innerIndexPtr()[begin(last - 1) + 1]) == last) {
      ++last;
    }
    Block block{first, last - first,  count(last - 1) - 1, static_cast<std::uint32_t>(row_list_.size()),
                kNone, values_.size()};
    for (std::uint32_t i = 0; i < block.rows; ++i) {
      row_list_.push_back(static_cast<std::uint32_t>(lower.innerIndexPtr()[begin(last - 1) + 1 + static_cast<int>(i)]));
    }
    values_.resize(values_.size() + static_cast<std::size_t>(block.width) * (block.width + block.rows), 0.f);
    float* values = values_.data() + block.values;
    for (std::uint32_t column = first; column < last; ++column) {
      const std::uint32_t k = column - first;
      block_of_[column] = static_cast<std::uint32_t>(blocks_.size());
      const double* entries = lower.valuePtr() + begin(column);
      inverse_diagonal_[column] = static_cast<float>(1 / entries[0]);
      for (std::uint32_t i = 1; i < count(column); ++i) {
        values[static_cast<std::size_t>(k + i) * block.width + k] = static_cast<float>(entries[i]);
      }
    }
    most_rows = std::max<std::size_t>(most_rows, block.rows);
    blocks_.push_back(block);
    first = last;
  }
  for (Block& block : blocks_) {
    if (block.rows > 0) block.parent = block_of_[row_list_[block.row_list]];
  }
  gathered_.resize(most_rows);
  reached_.assign(blocks_.size(), 0);
}

void SmoothingSolver::begin() {
  std::fill(x_.begin(), x_.end(), Lanes{});
  std::fill(reached_.begin(), reached_.end(), std::uint8_t{0});
}

void SmoothingSolver::add_load(std::uint32_t vertex, const Eigen::Vector3f& load) {
  const std::uint32_t column = position_[vertex];
  x_[column] += Lanes{load.x(), load.y(), load.z(), 0};
  for (std::uint32_t b = block_of_[column]; b != kNone && reached_[b] == 0; b = blocks_[b].parent) reached_[b] = 1;
}

void SmoothingSolver::forward(const Block& block) {
  const std::uint32_t width = block.width;
  const float* row = values_.data() + block.values;
  Lanes* y = x_.data() + block.first;
  for (std::uint32_t i = 0; i < width; ++i, row += width) {
    Lanes even = y[i], odd{};
    std::uint32_t k = 0;
    for (; k + 1 < i; k += 2) {
      even -= row[k] * y[k];
      odd -= row[k + 1] * y[k + 1];
    }
    if (k < i) even -= row[k] * y[k];
    y[i] = inverse_diagonal_[block.first + i] * (even + odd);
  }
  const std::uint32_t* rows = row_list_.data() + block.row_list;
  std::uint32_t r = 0;
  for (; r + 3 < block.rows; r += 4, row += 4 * static_cast<std::size_t>(width)) {
    const float *row1 = row + width, *row2 = row1 + width, *row3 = row2 + width;
    Lanes s0{}, s1{}, s2{}, s3{};
    for (std::uint32_t k = 0; k < width; ++k) {
      const Lanes value = y[k];
      s0 += row[k] * value;
      s1 += row1[k] * value;
      s2 += row2[k] * value;
      s3 += row3[k] * value;
    }
    x_[rows[r]] -= s0;
    x_[rows[r + 1]] -= s1;
    x_[rows[r + 2]] -= s2;
    x_[rows[r + 3]] -= s3;
  }
  for (; r < block.rows; ++r, row += width) {
    Lanes sum{};
    for (std::uint32_t k = 0; k < width; ++k) sum += row[k] * y[k];
    x_[rows[r]] -= sum;
  }
}

void SmoothingSolver::backward(const Block& block) {
  const std::uint32_t width = block.width;
  const float* below = values_.data() + block.values + static_cast<std::size_t>(width) * width;
  const std::uint32_t* rows = row_list_.data() + block.row_list;
  Lanes* y = x_.data() + block.first;
  for (std::uint32_t r = 0; r < block.rows; ++r) gathered_[r] = x_[rows[r]];
  std::uint32_t k = 0;
  for (; k + 7 < width; k += 8) {
    Lanes sum[8] = {};
    const float* row = below + k;
    for (std::uint32_t r = 0; r < block.rows; ++r, row += width) {
      for (int i = 0; i < 8; ++i) sum[i] += row[i] * gathered_[r];
    }
    for (int i = 0; i < 8; ++i) y[k + static_cast<std::uint32_t>(i)] -= sum[i];
  }
  for (; k < width; ++k) {
    Lanes even{}, odd{};
    const float* row = below + k;
    std::uint32_t r = 0;
    for (; r + 1 < block.rows; r += 2, row += 2 * static_cast<std::size_t>(width)) {
      even += row[0] * gathered_[r];
      odd += row[width] * gathered_[r + 1];
    }
    if (r < block.rows) even += row[0] * gathered_[r];
    y[k] -= even + odd;
  }
  for (std::uint32_t i = width; i-- > 0;) {
    y[i] *= inverse_diagonal_[block.first + i];
    const float* row = values_.data() + block.values + static_cast<std::size_t>(i) * width;
    for (std::uint32_t j = 0; j < i; ++j) y[j] -= row[j] * y[i];
  }
}

void SmoothingSolver::solve() {
  for (std::size_t b = 0; b < blocks_.size(); ++b) {
    if (reached_[b] != 0) forward(blocks_[b]);
  }
  // All rows of a reached block are in reached blocks.
  for (std::size_t b = blocks_.size(); b-- > 0;) {
    if (reached_[b] != 0) backward(blocks_[b]);
  }
}

void SmoothingSolver::spread(float smallest) {
  const auto faded = [&](const Block& block) {
    Lanes low{}, high{};
    for (std::uint32_t r = 0; r < block.rows; ++r) {
      const Lanes& value = x_[row_list_[block.row_list + r]];
      low = value < low ? value : low;
      high = value > high ? value : high;
    }
    float largest = 0;
    for (int k = 0; k < 3; ++k) largest = std::max({largest, -low[k], high[k]});
    return largest < smallest;
  };
  for (std::size_t b = blocks_.size(); b-- > 0;) {
    if (reached_[b] == 0 && !faded(blocks_[b])) backward(blocks_[b]);
  }
}

}  // namespace pleat::refinement
