#include "services/conversion/geometry_image/texel_fit.hpp"

#include "common/base/error.hpp"

namespace pleat::conversion {
namespace {

// E^2 inside charts and at their rims.
constexpr double kEpsilon = 1e-8, kRimEpsilon = 1e-4;
// Further solves for what the penalties have pulled the reads off.
constexpr int kCorrections = 1;
using Triplets = std::vector<Eigen::Triplet<double, int>>;

// Rows 1, -2, 1 over three neighbouring texels of one chart.
void add_second_differences(const TexelGrid& grid, const ChartRaster& raster, const std::vector<int>& unknown,
                            Triplets& entries, int& rows) {
  const auto add = [&](std::size_t first, std::size_t stride) {
    const std::size_t middle = first + stride, last = middle + stride;
    const std::uint32_t chart = raster.chart[middle];
    if (chart == kNone || raster.chart[first] != chart || raster.chart[last] != chart) return;
    entries.emplace_back(rows, unknown[first], 1);
    entries.emplace_back(rows, unknown[middle], -2);
    entries.emplace_back(rows, unknown[last], 1);
    ++rows;
  };
  const auto width = static_cast<std::size_t>(grid.width), height = static_cast<std::size_t>(grid.height);
  for (std::size_t row = 0; row < height; ++row) {
    for (std::size_t column = 0; column < width; ++column) {
      if (column + 2 < width) add(row * width + column, 1);
      if (row + 2 < height) add(row * width + column, width);
    }
  }
}

Eigen::SparseMatrix<double> make_sparse(int rows, int columns, const Triplets& entries) {
  Eigen::SparseMatrix<double> matrix(rows, columns);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

}  // namespace

TexelFit::TexelFit(const Topology& topology, const TexelGrid& grid, const ChartRaster& raster, double lambda) {
  if (!(lambda > 0)) throw_invalid_argument("fitted image: lambda must be positive");
  std::vector<int> unknown(grid.size(), -1);
  for (std::size_t texel = 0; texel < grid.size(); ++texel) {
    if (raster.sources[texel].face == kNone) continue;
    unknown[texel] = static_cast<int>(texels_.size());
    texels_.push_back(static_cast<std::uint32_t>(texel));
  }
  const int count = static_cast<int>(texels_.size());

  vertex_of_.assign(static_cast<std::size_t>(topology.uv.rows()), kNone);
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) vertex_of_[topology.uv_faces(f, k)] = topology.faces(f, k);
  }
  Triplets reads, right;
  for (std::size_t u = 0; u < vertex_of_.size(); ++u) {
    if (vertex_of_[u] == kNone) continue;
    for (std::size_t i = 0; i < 4; ++i) {
      const double weight = static_cast<double>(raster.reads[u].weight[i]);
      if (weight == 0) continue;
      reads.emplace_back(static_cast<int>(u), unknown[raster.reads[u].texel[i]], weight);
      right.emplace_back(unknown[raster.reads[u].texel[i]], static_cast<int>(vertex_of_[u]), weight);
    }
  }
  Eigen::VectorXd epsilon(count);
  for (int i = 0; i < count; ++i) {
    const std::uint32_t texel = texels_[static_cast<std::size_t>(i)];
    const TexelSource& source = raster.sources[texel];
    epsilon[i] = raster.is_rim[texel] != 0 ? kRimEpsilon : kEpsilon;
    for (int k = 0; k < 3; ++k) {
      const auto vertex = static_cast<int>(topology.faces(source.face, k));
      right.emplace_back(i, vertex, epsilon[i] * static_cast<double>(source.weight[static_cast<std::size_t>(k)]));
    }
  }
  right_ = make_sparse(count, static_cast<int>(topology.vertex_count()), right);

  Triplets differences;
  int rows = 0;
  add_second_differences(grid, raster, unknown, differences, rows);
  reads_ = make_sparse(static_cast<int>(topology.uv.rows()), count, reads);
  const Eigen::SparseMatrix<double> d = make_sparse(rows, count, differences);
  Eigen::SparseMatrix<double> e_part(count, count);
  e_part.setIdentity();
  e_part = epsilon.asDiagonal() * e_part;
  const Eigen::SparseMatrix<double> a_part = reads_.transpose() * reads_;
  const Eigen::SparseMatrix<double> d_part = d.transpose() * d;
  factor_ = std::make_unique<SparseCholesky>(a_part + lambda * d_part + e_part);
}

Eigen::MatrixXd TexelFit::solve(const Eigen::MatrixXd& vertex_values) const {
  Eigen::MatrixXd texels = factor_->solve(right_ * vertex_values);
  for (int i = 0; i < kCorrections; ++i) {
    // The reads of the vertices that the penalties have pulled off.
    Eigen::MatrixXd missing = -(reads_ * texels);
    for (std::size_t u = 0; u < vertex_of_.size(); ++u) {
      if (vertex_of_[u] != kNone) missing.row(static_cast<Eigen::Index>(u)) += vertex_values.row(vertex_of_[u]);
    }
    texels += factor_->solve(reads_.transpose() * missing);
  }
  return texels;
}

}  // namespace pleat::conversion
