// The judge of cleanness: what refinement promises, and what reports, evaluation and data set checks count.
// A frame is clean if both counts are 0.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::refinement {

/// Two faces that intersect, first < second.
using FacePair = std::array<std::uint32_t, 2>;

/// All pairs of faces of one mesh that intersect, ascending. Faces without a common vertex intersect if they share a
/// point; faces with a common vertex or edge intersect if they share a point beyond it. Decisions are exact for the
/// given floats. A face without area counts as the segment or point that it is.
/// positions: (V x 3), finite. Throws kInvalidArgument for an index out of range or values that are not finite.
/// At most kMaxReportedPairs pairs are returned. O(F log F + candidate pairs). For many frames of one mesh, keep a
/// SelfIntersectionFinder.
inline constexpr std::size_t kMaxReportedPairs = 10'000'000;
std::vector<FacePair> find_self_intersections(const Positions& positions, const Faces& faces);

/// The number of such pairs.
std::size_t count_self_intersections(const Positions& positions, const Faces& faces);

/// Faces of the cloth that reach into an obstacle, ascending, each once. Sphere: a point of the face is nearer to the
/// centre than the radius less 1e-6 m (the resolution of float positions). Closed mesh: the face intersects the
/// obstacle's surface, or lies inside (by more than 1e-6 m).
/// shapes: what stays constant, frames: the same obstacles in this frame, matched by name; a sphere needs no shape.
/// Throws kInvalidArgument for a mesh obstacle without shape or with another vertex count, or values that are not
/// finite.
std::vector<std::uint32_t> find_penetrations(const Positions& positions, const Faces& faces,
                                             std::span<const ObstacleShape> shapes,
                                             std::span<const ObstacleFrame> frames);

/// The number of such faces.
std::size_t count_penetrations(const Positions& positions, const Faces& faces, std::span<const ObstacleShape> shapes,
                               std::span<const ObstacleFrame> frames);

}  // namespace pleat::refinement
