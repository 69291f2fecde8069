#include "common/mesh/triangle_intersection.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace pleat {
namespace {

using Vec2 = Eigen::Vector2f;
using Vec3 = Eigen::Vector3f;

// An exact sum of doubles as a sum of non-overlapping parts, smallest first (Shewchuk 1997, Grow-Expansion with
// elimination of zeros). N bounds the number of summands.
template <std::size_t N>
class ExactSum {
 public:
  void add(double value) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < size_; ++i) {
      const double sum = value + parts_[i];
      const double rounded = sum - value;
      const double error = (value - (sum - rounded)) + (parts_[i] - rounded);
      if (error != 0) parts_[kept++] = error;
      value = sum;
    }
    if (value != 0) parts_[kept++] = value;
    size_ = kept;
  }
  // a b c of floats: a b is exact in double, the last product leaves a rounding error that fma returns.
  void add_product(float a, float b, float c, double sign) {
    const double ab = static_cast<double>(a) * static_cast<double>(b) * sign;
    const double high = ab * static_cast<double>(c);
    add(std::fma(ab, static_cast<double>(c), -high));
    add(high);
  }
  int sign() const { return size_ == 0 ? 0 : (parts_[size_ - 1] > 0 ? 1 : -1); }

 private:
  std::array<double, N> parts_{};
  std::size_t size_ = 0;
};

int orient3d_exact(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  // The 4 x 4 determinant with a column of ones: the four 3 x 3 minors, six triple products each.
  ExactSum<48> sum;
  const auto minor = [&sum](const Vec3& p, const Vec3& q, const Vec3& r, double sign) {
    sum.add_product(p.x(), q.y(), r.z(), sign);
    sum.add_product(p.y(), q.z(), r.x(), sign);
    sum.add_product(p.z(), q.x(), r.y(), sign);
    sum.add_product(p.z(), q.y(), r.x(), -sign);
    sum.add_product(p.x(), q.z(), r.y(), -sign);
    sum.add_product(p.y(), q.x(), r.z(), -sign);
  };
  minor(a, b, c, 1);
  minor(b, c, d, -1);
  minor(c, d, a, 1);
  minor(d, a, b, -1);
  return sum.sign();
}

int orient2d_exact(const Vec2& a, const Vec2& b, const Vec2& c) {
  ExactSum<6> sum;
  const auto product = [](float x, float y) { return static_cast<double>(x) * static_cast<double>(y); };
  sum.add(product(a.x(), b.y()));
  sum.add(-product(a.y(), b.x()));
  sum.add(product(b.x(), c.y()));
  sum.add(-product(b.y(), c.x()));
  sum.add(product(c.x(), a.y()));
  sum.add(-product(c.y(), a.x()));
  return sum.sign();
}

// The two coordinates other than `axis`.
Vec2 project(const Vec3& p, int axis) {
  return axis == 0 ? Vec2(p.y(), p.z()) : (axis == 1 ? Vec2(p.z(), p.x()) : Vec2(p.x(), p.y()));
}

int orient2d(const Vec3& a, const Vec3& b, const Vec3& c, int axis) {
  return pleat::orient2d(project(a, axis), project(b, axis), project(c, axis));
}

// An axis along which the triangle keeps its area, or -1 if it has none.
int projection_axis(const Vec3& a, const Vec3& b, const Vec3& c) {
  for (int axis = 0; axis < 3; ++axis) {
    if (orient2d(a, b, c, axis) != 0) return axis;
  }
  return -1;
}

bool boxes_overlap(const Vec3& p, const Vec3& q, const Vec3& r, const Vec3& s) {
  return (p.cwiseMin(q).array() <= r.cwiseMax(s).array()).all() &&
         (r.cwiseMin(s).array() <= p.cwiseMax(q).array()).all();
}

// Closed segments in one plane that projects one to one along the axis; collinear ones by their boxes.
bool coplanar_segments_intersect(const Vec3& p, const Vec3& q, const Vec3& r, const Vec3& s, int axis) {
  const int pqr = orient2d(p, q, r, axis), pqs = orient2d(p, q, s, axis);
  if (pqr * pqs > 0) return false;
  const int rsp = orient2d(r, s, p, axis), rsq = orient2d(r, s, q, axis);
  if (rsp * rsq > 0) return false;
  return pqr != 0 || pqs != 0 || rsp != 0 || rsq != 0 || boxes_overlap(p, q, r, s);
}

bool segments_intersect(const Vec3& p, const Vec3& q, const Vec3& r, const Vec3& s) {
  if (pleat::orient3d(p, q, r, s) != 0) return false;
  for (int axis = 0; axis < 3; ++axis) {
    if (orient2d(p, q, r, axis) != 0 || orient2d(p, q, s, axis) != 0 || orient2d(r, s, p, axis) != 0 ||
        orient2d(r, s, q, axis) != 0) {
      return coplanar_segments_intersect(p, q, r, s, axis);
    }
  }
  return boxes_overlap(p, q, r, s);
}

bool contains(const Triangle3f& t, const Vec3& p, int axis) {
  const int s0 = orient2d(t[0], t[1], p, axis), s1 = orient2d(t[1], t[2], p, axis), s2 = orient2d(t[2], t[0], p, axis);
  return !((s0 > 0 || s1 > 0 || s2 > 0) && (s0 < 0 || s1 < 0 || s2 < 0));
}

// The segment lies in the triangle's plane, or the triangle has no area.
bool flat_segment_intersects(const Vec3& p, const Vec3& q, const Triangle3f& t) {
  const int axis = projection_axis(t[0], t[1], t[2]);
  for (std::size_t k = 0; k < 3; ++k) {
    const Vec3 &r = t[k], &s = t[(k + 1) % 3];
    if (axis < 0 ? segments_intersect(p, q, r, s) : coplanar_segments_intersect(p, q, r, s, axis)) return true;
  }
  return axis >= 0 && contains(t, p, axis);
}

// side_p, side_q: orient3d of the triangle and the ends.
bool segment_intersects(const Vec3& p, const Vec3& q, int side_p, int side_q, const Triangle3f& t) {
  if (side_p * side_q > 0) return false;
  if (side_p == 0 && side_q == 0) return flat_segment_intersects(p, q, t);
  // The line meets the plane in one point; it is in the triangle if the line passes all edges on the same side.
  const int s0 = pleat::orient3d(p, q, t[0], t[1]);
  const int s1 = pleat::orient3d(p, q, t[1], t[2]);
  if (s0 * s1 < 0) return false;
  const int s2 = pleat::orient3d(p, q, t[2], t[0]);
  return s0 * s2 >= 0 && s1 * s2 >= 0;
}

std::array<int, 3> sides(const Triangle3f& plane, const Triangle3f& points) {
  return {orient3d(plane[0], plane[1], plane[2], points[0]), orient3d(plane[0], plane[1], plane[2], points[1]),
          orient3d(plane[0], plane[1], plane[2], points[2])};
}

bool all_on_one_side(const std::array<int, 3>& s) {
  return (s[0] > 0 && s[1] > 0 && s[2] > 0) || (s[0] < 0 && s[1] < 0 && s[2] < 0);
}

bool any_edge_intersects(const Triangle3f& edges_of, const std::array<int, 3>& side, const Triangle3f& t) {
  for (std::size_t k = 0; k < 3; ++k) {
    const std::size_t next = (k + 1) % 3;
    if (segment_intersects(edges_of[k], edges_of[next], side[k], side[next], t)) return true;
  }
  return false;
}

// Rounding errors of the sums of three products below are smaller than this, relative to the sizes involved.
constexpr double kSeparationMargin = 1e-13;

// Whether the plane between the centres certainly parts the triangles. Spares most exact sums between neighbours in one
// plane, for which every orient3d is in doubt.
bool certainly_apart(const Triangle3f& a, const Triangle3f& b) {
  std::array<Eigen::Vector3d, 3> p, q;
  for (std::size_t k = 0; k < 3; ++k) {
    p[k] = a[k].cast<double>();
    q[k] = b[k].cast<double>();
  }
  const Eigen::Vector3d axis = (q[0] + q[1] + q[2]) - (p[0] + p[1] + p[2]);
  const double high = std::max({axis.dot(p[0]), axis.dot(p[1]), axis.dot(p[2])});
  const double low = std::min({axis.dot(q[0]), axis.dot(q[1]), axis.dot(q[2])});
  double size = 0;
  for (std::size_t k = 0; k < 3; ++k) size = std::max({size, p[k].cwiseAbs().maxCoeff(), q[k].cwiseAbs().maxCoeff()});
  return low - high > kSeparationMargin * axis.lpNorm<1>() * size;
}

// Whether a plane through the common vertex v certainly parts the rest of (v, a1, a2) from the rest of (v, b1, b2).
bool certainly_apart_at(const Vec3& v, const Vec3& a1, const Vec3& a2, const Vec3& b1, const Vec3& b2) {
  const Eigen::Vector3d vd = v.cast<double>();
  const auto direction = [&vd](const Vec3& x) -> Eigen::Vector3d {
    const Eigen::Vector3d d = x.cast<double>() - vd;
    return d / std::max(d.norm(), 1e-300);
  };
  const Eigen::Vector3d p1 = direction(a1), p2 = direction(a2), q1 = direction(b1), q2 = direction(b2);
  const Eigen::Vector3d axis = (p1 + p2) - (q1 + q2);
  return axis.dot(p1) > kSeparationMargin && axis.dot(p2) > kSeparationMargin && axis.dot(q1) < -kSeparationMargin &&
         axis.dot(q2) < -kSeparationMargin;
}

}  // namespace

int orient3d(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Eigen::Vector3d dd = d.cast<double>();
  const Eigen::Vector3d u = a.cast<double>() - dd, v = b.cast<double>() - dd, w = c.cast<double>() - dd;
  const double vxwy = v.x() * w.y(), wxvy = w.x() * v.y();
  const double wxuy = w.x() * u.y(), uxwy = u.x() * w.y();
  const double uxvy = u.x() * v.y(), vxuy = v.x() * u.y();
  const double determinant = u.z() * (vxwy - wxvy) + v.z() * (wxuy - uxwy) + w.z() * (uxvy - vxuy);
  const double permanent = (std::abs(vxwy) + std::abs(wxvy)) * std::abs(u.z()) +
                           (std::abs(wxuy) + std::abs(uxwy)) * std::abs(v.z()) +
                           (std::abs(uxvy) + std::abs(vxuy)) * std::abs(w.z());
  // (7 + 56 e) e with e = 2^-53 (Shewchuk 1997). All products zero means a zero determinant: differences of floats in
  // double vanish only for equal floats, and no product of three underflows.
  constexpr double kBound = 7.8e-16;
  if (determinant > kBound * permanent) return 1;
  if (-determinant > kBound * permanent) return -1;
  if (permanent == 0) return 0;
  return orient3d_exact(a, b, c, d);
}

int orient2d(const Vec2& a, const Vec2& b, const Vec2& c) {
  const Eigen::Vector2d cc = c.cast<double>();
  const Eigen::Vector2d u = a.cast<double>() - cc, v = b.cast<double>() - cc;
  const double left = u.x() * v.y(), right = u.y() * v.x();
  const double determinant = left - right;
  const double permanent = std::abs(left) + std::abs(right);
  constexpr double kBound = 3.4e-16;  // (3 + 16 e) e
  if (determinant > kBound * permanent) return 1;
  if (-determinant > kBound * permanent) return -1;
  if (permanent == 0) return 0;
  return orient2d_exact(a, b, c);
}

bool segment_intersects_triangle(const Vec3& p, const Vec3& q, const Triangle3f& t) {
  return segment_intersects(p, q, orient3d(t[0], t[1], t[2], p), orient3d(t[0], t[1], t[2], q), t);
}

bool triangles_intersect(const Triangle3f& a, const Triangle3f& b) {
  if (certainly_apart(a, b)) return false;
  const std::array<int, 3> side_a = sides(b, a);
  if (all_on_one_side(side_a)) return false;
  const std::array<int, 3> side_b = sides(a, b);
  if (all_on_one_side(side_b)) return false;
  return any_edge_intersects(a, side_a, b) || any_edge_intersects(b, side_b, a);
}

bool faces_intersect(const Positions& positions, const Faces& faces, std::uint32_t first, std::uint32_t second) {
  const auto corner = [&](std::uint32_t face, int k) -> Vec3 { return positions.row(faces(face, k)); };
  std::array<int, 2> common_a{}, common_b{};
  int common = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      if (faces(first, i) != faces(second, j)) continue;
      if (common == 2) return true;  // the same three vertices
      common_a[static_cast<std::size_t>(common)] = i;
      common_b[static_cast<std::size_t>(common++)] = j;
    }
  }
  const Triangle3f a{corner(first, 0), corner(first, 1), corner(first, 2)};
  const Triangle3f b{corner(second, 0), corner(second, 1), corner(second, 2)};
  if (common == 0) return triangles_intersect(a, b);
  if (common == 1) {
    const int i = common_a[0], j = common_b[0];
    if (certainly_apart_at(corner(first, i), corner(first, (i + 1) % 3), corner(first, (i + 2) % 3),
                           corner(second, (j + 1) % 3), corner(second, (j + 2) % 3))) {
      return false;
    }
    return segment_intersects_triangle(corner(first, (i + 1) % 3), corner(first, (i + 2) % 3), b) ||
           segment_intersects_triangle(corner(second, (j + 1) % 3), corner(second, (j + 2) % 3), a);
  }
  const Vec3 u = corner(first, common_a[0]), v = corner(first, common_a[1]);
  const Vec3 p = corner(first, 3 - common_a[0] - common_a[1]), q = corner(second, 3 - common_b[0] - common_b[1]);
  // Not folded by more than a right angle: certainly on different sides of the edge.
  const Eigen::Vector3d ud = u.cast<double>(), edge = v.cast<double>() - ud;
  const Eigen::Vector3d up = p.cast<double>() - ud, uq = q.cast<double>() - ud;
  const double bound = edge.squaredNorm() * (up.squaredNorm() + uq.squaredNorm());
  if (edge.cross(up).dot(edge.cross(uq)) < -kSeparationMargin * bound) return false;
  if (orient3d(u, v, p, q) != 0) return false;
  int axis = projection_axis(u, v, p);
  if (axis < 0) axis = projection_axis(u, v, q);
  if (axis < 0) return true;
  return orient2d(u, v, p, axis) * orient2d(u, v, q, axis) > 0;
}

}  // namespace pleat
