// Moves cloth out of obstacles and keeps its wrinkles (DESIGN section 5; [DT-S] section 2.3).
#pragma once

#include <memory>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "common/mesh/sparse_cholesky.hpp"
#include "services/refinement/obstacle_field.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat {

/// Minimises alpha |u|^2 + |L u|^2 - 2 f.u over displacements u, where L is the uniform Laplacian of the mesh and the
/// loads f act on the vertices that must move: the differences of neighbours, and so the wrinkles, change as little as
/// possible. The matrix depends on the connectivity alone and is factorised by the first frame that needs it.
class ObstaclePush {
 public:
  /// rounds: solves per frame at most, before the remaining vertices are projected.
  ObstaclePush(Faces faces, Eigen::Index vertex_count, int rounds);

  /// Moves every vertex that is inside an obstacle or nearer than `clearance` to it, then pushes faces out that still
  /// reach in. finder: updated for `positions` before the call, and again here if anything moved. Returns whether
  /// anything moved. Faces between obstacles that leave no room may still reach in afterwards.
  bool apply(Positions& positions, const ObstacleField& field, SelfIntersectionFinder& finder, double clearance);

 private:
  const SparseCholesky& factor();

  Faces faces_;
  Eigen::Index vertex_count_;
  int rounds_;
  std::unique_ptr<SparseCholesky> factor_;
};

/// The faces near obstacles that reach into them, ascending. finder: updated for `positions`.
std::vector<std::uint32_t> find_penetrations(const Positions& positions, const ObstacleField& field,
                                             const SelfIntersectionFinder& finder);

}  // namespace pleat
