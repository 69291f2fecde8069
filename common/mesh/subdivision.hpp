// Midpoint subdivision and the linear upsampling that belongs to it ([MFSR] section 4.1).
#pragma once

#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// A fine mesh made from a coarse one. The coarse vertices come first and keep their indices, so
/// feature_vertices[i] == i; it is stored all the same because other generators need not do so.
struct Subdivision {
  Topology fine;
  std::vector<std::uint32_t> feature_vertices;  ///< (V_coarse) indices into the fine mesh

  /// Each fine vertex as a combination of the corners of one coarse face.
  std::vector<std::uint32_t> parent_face;                                ///< (V_fine) coarse face
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> barycentric;  ///< (V_fine x 3), rows sum to 1
};

/// Splits every edge in 2^rounds: rounds = 2 gives the paper's 16 faces per face (749 -> 11,393 vertices). Material
/// coordinates are split along, so that seams stay seams. O(F 4^rounds).
Subdivision subdivide(const Topology& coarse, int rounds = 2);

/// Barycentric upsampling of a coarse frame: (V_coarse x 3) -> (V_fine x 3). The surface stays the same set of points.
Positions upsample(const Subdivision& subdivision, const Faces& coarse_faces, const Positions& coarse_positions);
/// The same into memory that is reused.
void upsample(const Subdivision& subdivision, const Faces& coarse_faces, const Positions& coarse_positions,
              Positions& fine);

}  // namespace pleat
