// Forces and stiffness of one triangle and of one hinge. Templates on the scalar: float in the solver, double in tests.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "services/simulation/material.hpp"

namespace pleat::simulation {

/// Rest data of a triangle: the gradients of its shape functions in material coordinates (1/m) and its area (m^2).
template <typename T>
struct TriangleRest {
  std::array<T, 3> du, dv;  // d phi_i / du, d phi_i / dv; they sum to 0
  T area;
};

/// Green strain of a triangle and the tangents it comes from.
template <typename T>
struct TriangleStrain {
  Eigen::Matrix<T, 3, 1> xu, xv;  // columns of the deformation gradient
  T g00, g11, g01;
};

/// edge1 = x1 - x0, edge2 = x2 - x0.
template <typename T>
TriangleStrain<T> triangle_strain(const TriangleRest<T>& rest, const Eigen::Matrix<T, 3, 1>& edge1,
                                  const Eigen::Matrix<T, 3, 1>& edge2) {
  TriangleStrain<T> s;
  s.xu = rest.du[1] * edge1 + rest.du[2] * edge2;
  s.xv = rest.dv[1] * edge1 + rest.dv[2] * edge2;
  s.g00 = (s.xu.squaredNorm() - 1) / 2;
  s.g11 = (s.xv.squaredNorm() - 1) / 2;
  s.g01 = s.xu.dot(s.xv) / 2;
  return s;
}

/// Energy (J) at fixed moduli: a/2 (k0 G00^2 + k2 G11^2 + 2 k1 G00 G11 + 2 k3 G01^2).
template <typename T>
T stretching_energy(const TriangleRest<T>& rest, const Moduli& k, const TriangleStrain<T>& s) {
  return rest.area / 2 *
         (T(k.c11) * s.g00 * s.g00 + T(k.c22) * s.g11 * s.g11 + 2 * T(k.c12) * s.g00 * s.g11 +
          2 * T(k.c33) * s.g01 * s.g01);
}

/// Forces (N) on the corners 1 and 2; the force on corner 0 is minus their sum. -dE/dx at fixed moduli.
template <typename T>
void stretching_forces(const TriangleRest<T>& rest, const Moduli& k, const TriangleStrain<T>& s,
                       Eigen::Matrix<T, 3, 1>& force1, Eigen::Matrix<T, 3, 1>& force2) {
  const T s00 = T(k.c11) * s.g00 + T(k.c12) * s.g11;
  const T s11 = T(k.c12) * s.g00 + T(k.c22) * s.g11;
  const T s01 = T(k.c33) * s.g01;
  const Eigen::Matrix<T, 3, 1> pu = -rest.area * (s00 * s.xu + s01 * s.xv);
  const Eigen::Matrix<T, 3, 1> pv = -rest.area * (s01 * s.xu + s11 * s.xv);
  force1 = rest.du[1] * pu + rest.dv[1] * pv;
  force2 = rest.du[2] * pu + rest.dv[2] * pv;
}

/// The off-diagonal 3x3 blocks of the positive semi-definite stiffness K = -dF/dx: blocks[0] couples corners (0,1),
/// [1] (1,2), [2] (2,0); row of the first corner. Diagonal blocks are minus the sum of their row: translations are
/// free. Compressive and shear geometric terms are left out, which makes K positive semi-definite.
template <typename T>
void stretching_stiffness(const TriangleRest<T>& rest, const Moduli& k, const TriangleStrain<T>& s,
                          std::array<Eigen::Matrix<T, 3, 3>, 3>& blocks) {
  using Mat3 = Eigen::Matrix<T, 3, 3>;
  const T tension_u = std::max(s.g00, T(0)), tension_v = std::max(s.g11, T(0));
  const Mat3 uu = s.xu * s.xu.transpose(), vv = s.xv * s.xv.transpose(), uv = s.xu * s.xv.transpose();
  Mat3 muu = rest.area * (T(k.c11) * uu + T(k.c33) / 2 * vv);
  Mat3 mvv = rest.area * (T(k.c22) * vv + T(k.c33) / 2 * uu);
  const Mat3 muv = rest.area * (T(k.c12) * uv + T(k.c33) / 2 * uv.transpose());
  muu.diagonal().array() += rest.area * (T(k.c11) * tension_u + T(k.c12) * tension_v);
  mvv.diagonal().array() += rest.area * (T(k.c22) * tension_v + T(k.c12) * tension_u);
  for (std::size_t e = 0; e < 3; ++e) {
    const std::size_t a = e, b = (e + 1) % 3;
    blocks[e] = (rest.du[a] * rest.du[b]) * muu + (rest.dv[a] * rest.dv[b]) * mvv + (rest.du[a] * rest.dv[b]) * muv +
                (rest.dv[a] * rest.du[b]) * muv.transpose();
  }
}

/// Dihedral angle of a hinge and its gradient. Edge x0 -> x1 as in its first face, x2 opposite in the first face, x3
/// in the second. 0 when flat, negative where the faces fold towards the side of their normals.
template <typename T>
struct HingeAngle {
  T theta;                                         // radians, (-pi, pi]
  std::array<Eigen::Matrix<T, 3, 1>, 4> gradient;  // d theta / d x_i, 1/m; they sum to 0
};

/// edge = x1 - x0, wing0 = x2 - x0, wing1 = x3 - x0. Heights are floored at a thousandth of the edge, so that a
/// collapsed face gives a large but finite gradient.
template <typename T>
HingeAngle<T> hinge_angle(const Eigen::Matrix<T, 3, 1>& edge, const Eigen::Matrix<T, 3, 1>& wing0,
                          const Eigen::Matrix<T, 3, 1>& wing1) {
  using Vec3 = Eigen::Matrix<T, 3, 1>;
  HingeAngle<T> h;
  const T tiny = T(1e-18);
  const T length2 = std::max(edge.squaredNorm(), tiny), length = std::sqrt(length2);
  const Vec3 n0 = edge.cross(wing0), n1 = wing1.cross(edge);
  const T size0 = std::max(n0.norm(), tiny), size1 = std::max(n1.norm(), tiny);
  const Vec3 unit0 = n0 / size0, unit1 = n1 / size1;
  h.theta = std::atan2(edge.dot(unit0.cross(unit1)) / length, unit0.dot(unit1));
  const T floor = T(1e-3) * length;
  const T t0 = wing0.dot(edge) / length2, t1 = wing1.dot(edge) / length2;
  // Moving a wing along its normal folds towards the normals: theta falls.
  const Vec3 g0 = -unit0 / std::max(size0 / length, floor), g1 = -unit1 / std::max(size1 / length, floor);
  h.gradient[2] = g0;
  h.gradient[3] = g1;
  h.gradient[0] = -((1 - t0) * g0 + (1 - t1) * g1);
  h.gradient[1] = -(t0 * g0 + t1 * g1);
  return h;
}

/// Rest data of a hinge.
template <typename T>
struct HingeRest {
  T shape;                     // l^2 / (2 (a0 + a1))
  T curvature_per_radian;      // l / (a0 + a1), 1/m
  std::array<T, 5> stiffness;  // N m at |kappa| = 0, 10, 20, 30, 40 1/m in the edge's direction
};

/// Bending stiffness at an angle: linear in |kappa| between the samples, constant beyond.
template <typename T>
T hinge_stiffness(const HingeRest<T>& rest, T theta) {
  const T q = std::min(T(0.1) * std::abs(theta * rest.curvature_per_radian), T(4));
  const int column = std::min(static_cast<int>(q), 3);
  const auto c = static_cast<std::size_t>(column);
  return rest.stiffness[c] + (q - T(column)) * (rest.stiffness[c + 1] - rest.stiffness[c]);
}

/// Energy at fixed stiffness: ke shape theta^2 / 4. Its force is -moment(...) * gradient, its Gauss-Newton stiffness
/// curvature(...) * gradient gradient^T.
template <typename T>
T hinge_energy(const HingeRest<T>& rest, T ke, T theta) {
  return ke * rest.shape * theta * theta / 4;
}
template <typename T>
T hinge_moment(const HingeRest<T>& rest, T ke, T theta) {
  return ke * rest.shape * theta / 2;
}
template <typename T>
T hinge_curvature(const HingeRest<T>& rest, T ke) {
  return ke * rest.shape / 2;
}

}  // namespace pleat::simulation
