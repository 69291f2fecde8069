// A judge of cleanness that shares no code with the engine: CGAL with exact predicates.
#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::test {

struct Judgement {
  std::size_t self_intersections = 0;  ///< pairs of cloth faces, and faces without area
  std::size_t penetrations = 0;        ///< pairs of a cloth face and an obstacle face; cloth vertices inside; cloth
                                       ///< faces that reach into a sphere or a capsule
  std::string first;                   ///< the first thing found, in words

  bool clean() const { return self_intersections == 0 && penetrations == 0; }
};

/// Judges the float positions as they are: two faces may share their common vertices and edge and nothing else, no face
/// comes nearer to a sphere's centre or a capsule's axis than its radius, no vertex is inside a closed mesh. Obstacles
/// may meet each other. cloth and meshes must be edge-manifold. O(F log F).
Judgement judge(const Positions& cloth, const Faces& faces, std::span<const ObstacleShape> shapes,
                std::span<const ObstacleFrame> obstacles);

}  // namespace pleat::test
