// The fitted fine image (docs/conversion.md): texels chosen so that bilinear reads reproduce the vertices. Internal.
#pragma once

#include <vector>

#include "common/mesh/sparse_cholesky.hpp"
#include "services/conversion/geometry_image/chart_raster.hpp"

namespace pleat::conversion {

/// Solves min_x |A x - y|^2 + lambda |D x|^2 + |E (x - S y)|^2 over the valid texels x for vertex values y, where A are
/// the vertices' bilinear reads, D the second differences along rows and columns inside one chart, and S the sampled
/// image. E^2 is 1e-8, which only decides texels that neither A nor D reaches; at rims 1e-4, because a texel that a
/// vertex reads with a small weight would be thrown far off to mend that vertex. Factorised once; a second solve with
/// the same factor adds the fit of what the first has left of y, so that the penalties cost next to no detail.
class TexelFit {
 public:
  /// raster: with reads. Throws kInvalidArgument for lambda <= 0.
  TexelFit(const Topology& topology, const TexelGrid& grid, const ChartRaster& raster, double lambda);

  /// vertex_values: (V x k). Returns (texels x k): valid texels only, in the order of texels().
  Eigen::MatrixXd solve(const Eigen::MatrixXd& vertex_values) const;

  /// The valid texels, ascending.
  const std::vector<std::uint32_t>& texels() const { return texels_; }

 private:
  std::vector<std::uint32_t> texels_;
  std::vector<std::uint32_t> vertex_of_;  // per material coordinate; kNone where no face uses it
  Eigen::SparseMatrix<double> reads_;     // (U x texels): A
  Eigen::SparseMatrix<double> right_;     // (texels x V): A^T + E^2 S
  std::unique_ptr<SparseCholesky> factor_;
};

}  // namespace pleat::conversion
