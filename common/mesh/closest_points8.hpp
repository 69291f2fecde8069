// Distances of vertex-face and edge-edge pairs eight at a time in float32 (closest_points.hpp has them in double):
// enough to tell who is surely too far away.
#pragma once

#include "common/base/simd.hpp"

namespace pleat {

/// Three coordinates of eight points, metres.
struct Points8 {
  Float8 x, y, z;

  Points8 operator+(const Points8& o) const { return {x + o.x, y + o.y, z + o.z}; }
  Points8 operator-(const Points8& o) const { return {x - o.x, y - o.y, z - o.z}; }
  Points8 operator*(Float8 s) const { return {s * x, s * y, s * z}; }
};
inline Float8 dot(const Points8& a, const Points8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Points8 cross(const Points8& a, const Points8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// What float32 may be wrong by in any coordinate or distance of points about there, metres.
inline Float8 rounding(const Points8& p) { return 1e-6f * (1 + max(max(abs(p.x), abs(p.y)), abs(p.z))); }

/// The least that a distance can be whose square was measured in float32, metres. error: the largest rounding() of the
/// points that it was measured between.
inline Float8 at_least(Float8 squared, Float8 error) { return (1 - 1e-5f) * sqrt(squared) - 4 * error; }

inline Float8 clamp01(Float8 t) { return min(max(t, Float8{}), broadcast8(1)); }

inline Float8 squared_distance_to_segment(const Points8& p, const Points8& a, const Points8& b) {
  const Points8 ab = b - a, ap = p - a;
  const Points8 way = ap - ab * clamp01(dot(ap, ab) / max(dot(ab, ab), broadcast8(1e-30f)));
  return dot(way, way);
}

/// Of p and the triangle a, b, c: that to its plane where the foot is inside, else that to the nearest edge.
inline Float8 squared_vertex_face_distance(const Points8& p, const Points8& a, const Points8& b, const Points8& c) {
  const Points8 ab = b - a, ac = c - a, ap = p - a, normal = cross(ab, ac);
  const Float8 area = dot(normal, normal), v = dot(cross(ap, ac), normal), w = dot(cross(ab, ap), normal);
  const Int8 inside = (v >= 0) & (w >= 0) & (v + w <= area) & (area > 0);
  const Float8 height = dot(normal, ap), plane = height * height / max(area, broadcast8(1e-30f));
  const Float8 edges = min(squared_distance_to_segment(p, a, b),
                           min(squared_distance_to_segment(p, b, c), squared_distance_to_segment(p, c, a)));
  return select(inside, min(plane, edges), edges);
}

/// Of the segments a0-a1 and b0-b1 (Ericson 2005, section 5.1.9). Where they are almost parallel rounding moves the
/// points along them, which changes the distance by next to nothing.
inline Float8 squared_edge_edge_distance(const Points8& a0, const Points8& a1, const Points8& b0, const Points8& b1) {
  const Points8 d1 = a1 - a0, d2 = b1 - b0, r = a0 - b0;
  const Float8 tiny = broadcast8(1e-30f);
  const Float8 a = max(dot(d1, d1), tiny), e = max(dot(d2, d2), tiny), b = dot(d1, d2), c = dot(d1, r), f = dot(d2, r);
  const Float8 s = clamp01((b * f - c * e) / max(a * e - b * b, tiny));
  const Float8 t = clamp01((b * s + f) / e);
  const Points8 way = r + d1 * clamp01((b * t - c) / a) - d2 * t;
  return dot(way, way);
}

}  // namespace pleat
