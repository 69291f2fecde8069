// Moves cloth out of obstacles and keeps its wrinkles (docs/refinement.md; [DT-S] section 2.3).
#pragma once

#include <optional>
#include <vector>

#include "common/frame/obstacle_field.hpp"
#include "common/mesh/mesh.hpp"
#include "services/refinement/cloth_contacts.hpp"
#include "services/refinement/self_intersection_finder.hpp"
#include "services/refinement/smoothing_solver.hpp"

namespace pleat::refinement {

/// Minimises alpha |u|^2 + |L u|^2 - 2 f.u over displacements u, where L is the uniform Laplacian of the mesh and the
/// loads f act on the vertices that must move: the differences of neighbours, and so the wrinkles, change as little as
/// possible. The matrix depends on the connectivity alone. Keeps its memory.
class ObstaclePush {
 public:
  /// rounds: solves per frame at most, before the remaining vertices are projected.
  ObstaclePush(const Faces& faces, Eigen::Index vertex_count, int rounds)
      : faces_(faces), vertex_count_(vertex_count), rounds_(rounds) {}

  /// Factorises now instead of in the first frame that needs it.
  void prepare();

  /// Moves every vertex that is inside an obstacle or nearer than `clearance` to it, then pushes faces out that still
  /// reach in. finder and contacts: updated for `positions` before the call, and again here if anything moved. Returns
  /// whether anything moved. Faces between obstacles that leave no room may still reach in afterwards.
  bool apply(Positions& positions, ObstacleField& field, SelfIntersectionFinder& finder, ClothContacts& contacts,
             double clearance);

 private:
  bool solve(Positions& positions, double clearance);
  bool project(Positions& positions, const ObstacleField& field, double clearance);

  Faces faces_;
  Eigen::Index vertex_count_;
  int rounds_;
  std::optional<SmoothingSolver> solver_;
  std::vector<VertexContact> contacts_, still_;
  std::vector<std::uint32_t> penetrating_;
};

}  // namespace pleat::refinement
