// Intersection of triangles with exact decisions: the signs of all determinants are those of the given floats, without
// rounding (floating-point filters in double, then exact sums of products).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// Sign of det [a-d, b-d, c-d]: +1 if d is below the plane of a, b, c (from where they look clockwise), -1 above, 0 if
/// the four points are coplanar. Exact.
int orient3d(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c, const Eigen::Vector3f& d);

/// Sign of the area of (a, b, c): +1 counter-clockwise, 0 collinear. Exact.
int orient2d(const Eigen::Vector2f& a, const Eigen::Vector2f& b, const Eigen::Vector2f& c);

using Triangle3f = std::array<Eigen::Vector3f, 3>;

/// Whether two closed triangles share a point; coplanar and touching ones count. A triangle without area is the segment
/// or point that it is.
bool triangles_intersect(const Triangle3f& a, const Triangle3f& b);

/// Whether the closed segment p-q and a closed triangle share a point.
bool segment_intersects_triangle(const Eigen::Vector3f& p, const Eigen::Vector3f& q, const Triangle3f& triangle);

/// Whether two different faces of one mesh intersect beyond what they have in common:
/// - no common vertex: they share a point (triangles_intersect);
/// - one common vertex: they share another point, which is so exactly if the edge opposite to the common vertex in one
///   meets the other face (the ray from the vertex to a common point leaves one of the faces first, inside the other);
/// - a common edge: they are coplanar and on the same side of it. Two faces without area on one edge count.
/// Vertices are common if their indices are. A face without area whose common vertex lies on its opposite edge counts
/// as intersecting.
bool faces_intersect(const Positions& positions, const Faces& faces, std::uint32_t first, std::uint32_t second);

}  // namespace pleat
