// Per-zone interpolation between the refined and the upsampled coarse mesh ([MFSR] section 5.2). Internal to this room.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/refinement/obstacle_field.hpp"
#include "services/refinement/self_intersection_finder.hpp"

namespace pleat {

/// Vertices around each vertex, in compressed rows, and faces likewise.
struct Neighbourhood {
  std::vector<std::uint32_t> vertex_offsets, vertices;
  std::vector<std::uint32_t> face_offsets, faces;
};
Neighbourhood build_neighbourhood(const Faces& faces, Eigen::Index vertex_count);

/// What one resolution works on. Every vertex stays on the segment from `safe` (weight 0) to `wanted` (weight 1).
struct BlendProblem {
  const Positions* safe;    ///< the upsampled coarse mesh
  const Positions* wanted;  ///< the fine mesh after the obstacles
  const ObstacleField* field;
  const Neighbourhood* neighbourhood;
  int bisections;
  bool may_take_all;  ///< a zone may grow to the whole mesh: `safe` is clean
};

/// Groups the offences into zones of connected offences with one ring around, and finds for each zone the largest
/// weight (among those that bisection visits) at which its faces are clean against everything. A zone that is not clean
/// at weight 0 grows by its offenders and by rings, swallowing other zones, until it is clean or is the whole mesh.
/// positions: current, changed in place; finder: updated for them, and kept so. all: start with one zone of all
/// vertices. Returns the number of zones.
std::size_t resolve_zones(const BlendProblem& problem, std::span<const FacePair> pairs,
                          std::span<const std::uint32_t> penetrations, bool all, Positions& positions,
                          SelfIntersectionFinder& finder);

}  // namespace pleat
