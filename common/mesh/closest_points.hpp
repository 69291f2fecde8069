// Closest points of vertex-face and edge-edge pairs: the distances of all contact and collision code.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

namespace pleat {

/// The closest points of two primitives with four vertices x0..x3 in all, as signed weights that sum to 0: the vector
/// from the point on the second primitive to the point on the first is sum_i weights[i] x_i.
struct ClosestPoints {
  Eigen::Vector3d difference;     ///< metres
  double squared_distance;        ///< |difference|^2
  std::array<double, 4> weights;  ///< vertex-face: 1, -b0, -b1, -b2; edge-edge: 1-s, s, -(1-t), -t
  bool interior;                  ///< neither point is on the boundary of its primitive (a vertex has none)
};

/// Parameter in [0,1] of the point of segment a-b that is closest to p; 0 for a segment without length.
inline double closest_on_segment(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d ab = b - a;
  const double length2 = ab.squaredNorm();
  return length2 > 0 ? std::clamp((p - a).dot(ab) / length2, 0.0, 1.0) : 0.0;
}

/// Barycentric coordinates of the point of triangle a,b,c that is closest to p (Ericson 2005, section 5.1.5). A
/// triangle without area is treated as its edges. The distance is right to 1e-8 of the triangle's size, whatever its
/// shape.
inline Eigen::Vector3d closest_on_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                           const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  const double d00 = ab.squaredNorm(), d01 = ab.dot(ac), d11 = ac.squaredNorm();
  const double determinant = d00 * d11 - d01 * d01;
  if (determinant > 1e-6 * d00 * d11) {
    const double v = d11 * d1 - d01 * d2, w = d00 * d2 - d01 * d1;
    if (v >= 0 && w >= 0 && v + w <= determinant) {
      const double bv = v / determinant, bw = w / determinant;
      return {1 - bv - bw, bv, bw};
    }
  } else {
    // A needle: the products above cancel to rounding errors of 1e-16 / sin^2, these to 1e-16 / sin.
    const Eigen::Vector3d normal = ab.cross(ac);
    const double area2 = normal.squaredNorm();
    if (area2 > 1e-16 * d00 * d11) {
      const double v = ap.cross(ac).dot(normal), w = ab.cross(ap).dot(normal);
      if (v >= 0 && w >= 0 && v + w <= area2) return {1 - (v + w) / area2, v / area2, w / area2};
    }
  }
  // On the boundary: the best of the three edges.
  const double tab = closest_on_segment(p, a, b), tac = closest_on_segment(p, a, c), tbc = closest_on_segment(p, b, c);
  const double dab = (ap - tab * ab).squaredNorm(), dac = (ap - tac * ac).squaredNorm();
  const double dbc = (p - b - tbc * (c - b)).squaredNorm();
  if (dab <= dac && dab <= dbc) return {1 - tab, tab, 0};
  if (dac <= dbc) return {1 - tac, 0, tac};
  return {0, 1 - tbc, tbc};
}

/// Vertex x0 and face x1,x2,x3.
inline ClosestPoints closest_vertex_face(const Eigen::Vector3d& x0, const Eigen::Vector3d& x1,
                                         const Eigen::Vector3d& x2, const Eigen::Vector3d& x3) {
  const Eigen::Vector3d b = closest_on_triangle(x0, x1, x2, x3);
  const Eigen::Vector3d difference = (x0 - x1) - b[1] * (x2 - x1) - b[2] * (x3 - x1);
  return {difference, difference.squaredNorm(), {1, -b[0], -b[1], -b[2]}, b[0] > 0 && b[1] > 0 && b[2] > 0};
}

/// Edge x0-x1 and edge x2-x3 (Ericson 2005, section 5.1.9); parallel edges by their ends. An error of s moves the
/// points along both edges, and apart only by the sine of their angle: down to a sine of 3e-8 the distance is right to
/// 1e-8.
inline ClosestPoints closest_edge_edge(const Eigen::Vector3d& x0, const Eigen::Vector3d& x1, const Eigen::Vector3d& x2,
                                       const Eigen::Vector3d& x3) {
  const Eigen::Vector3d d1 = x1 - x0, d2 = x3 - x2, r = x0 - x2;
  const double a = d1.squaredNorm(), e = d2.squaredNorm(), b = d1.dot(d2), c = d1.dot(r), f = d2.dot(r);
  const double denominator = a * e - b * b;
  double s = 0, t = 0;
  if (denominator > 1e-15 * a * e) {
    s = std::clamp((b * f - c * e) / denominator, 0.0, 1.0);
    t = (b * s + f) / e;
    if (t < 0) {
      t = 0;
      s = std::clamp(-c / a, 0.0, 1.0);
    } else if (t > 1) {
      t = 1;
      s = std::clamp((b - c) / a, 0.0, 1.0);
    }
  } else {
    double best = -1;
    const auto consider = [&](double s_try, double t_try) {
      const double distance = (r + s_try * d1 - t_try * d2).squaredNorm();
      if (best < 0 || distance < best) {
        best = distance;
        s = s_try;
        t = t_try;
      }
    };
    consider(0, closest_on_segment(x0, x2, x3));
    consider(1, closest_on_segment(x1, x2, x3));
    consider(closest_on_segment(x2, x0, x1), 0);
    consider(closest_on_segment(x3, x0, x1), 1);
  }
  const Eigen::Vector3d difference = r + s * d1 - t * d2;
  return {difference, difference.squaredNorm(), {1 - s, s, t - 1, -t}, s > 0 && s < 1 && t > 0 && t < 1};
}

}  // namespace pleat
