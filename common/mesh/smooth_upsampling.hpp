// Smooth upsampling of coarse frames: what a fine cloth looks like without any detail of its own.
#pragma once

#include <Eigen/SparseCore>
#include <vector>

#include "common/mesh/subdivision.hpp"

namespace pleat {

/// Loop's surface (1987) over the coarse frame, taken straight above the barycentrically upsampled vertices, as
/// SubdivisionRule::kSmooth has it for rest meshes: nothing slides across the cloth. Everything that depends on the
/// meshes alone is one sparse matrix, made once.
class SmoothUpsampling {
 public:
  /// `subdivision`: of `coarse`. O(V_fine).
  SmoothUpsampling(const Topology& coarse, const Subdivision& subdivision);

  /// (V_coarse x 3) -> (V_fine x 3) metres. O(V_fine). Throws kInvalidArgument for another number of vertices.
  Positions operator()(const Positions& coarse) const;

 private:
  using Weights = Eigen::SparseMatrix<float, Eigen::RowMajor>;
  Faces fine_faces_;
  Weights linear_;  ///< (V_fine x V_coarse)
  Weights loop_;    ///< the same, of Loop's rules
};

}  // namespace pleat
