#include "services/conversion/vertex_features/polar.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>

namespace pleat::conversion {
namespace {

constexpr int kMostPasses = 12;

Float8 squared_norm(const Matrix8& a) {
  Float8 sum{};
  for (const Float8& x : a) sum += x * x;
  return sum;
}

Matrix8 cofactors(const Matrix8& a) {
  return {a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6],
          a[2] * a[7] - a[1] * a[8], a[0] * a[8] - a[2] * a[6], a[1] * a[6] - a[0] * a[7],
          a[1] * a[5] - a[2] * a[4], a[2] * a[3] - a[0] * a[5], a[0] * a[4] - a[1] * a[3]};
}

Float8 determinant(const Matrix8& a, const Matrix8& cofactor) {
  return a[0] * cofactor[0] + a[1] * cofactor[1] + a[2] * cofactor[2];
}

// In double: the nearest proper rotation, by the singular vectors.
void decompose_lane(const Matrix8& gradient, int lane, Matrix8& rotation) {
  Eigen::Matrix3d t;
  for (int k = 0; k < 9; ++k) t(k / 3, k % 3) = static_cast<double>(gradient[static_cast<std::size_t>(k)][lane]);
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(t, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  if ((u * svd.matrixV().transpose()).determinant() < 0) u.col(2) = -u.col(2);
  const Eigen::Matrix3d r = u * svd.matrixV().transpose();
  for (int k = 0; k < 9; ++k) rotation[static_cast<std::size_t>(k)][lane] = static_cast<float>(r(k / 3, k % 3));
}

}  // namespace

Polar8 polar_decomposition(const Matrix8& gradient) {
  // Newton's steps lose a digit for each of the condition, so it gets matrices that are far from singular.
  const Float8 size = squared_norm(gradient) * (1.0f / 3);
  const Float8 volume = determinant(gradient, cofactors(gradient));
  const Int8 regular = (volume > 1e-2f * size * sqrt(size)) & (size < 1e8f) & (size > 1e-8f);
  Matrix8 x = gradient;
  for (std::size_t k = 0; k < 9; ++k) x[k] = select(regular, x[k], broadcast8(k % 4 == 0 ? 1 : 0));
  for (int pass = 0; pass < kMostPasses; ++pass) {
    const Matrix8 cofactor = cofactors(x);
    const Float8 det = determinant(x, cofactor);
    const Float8 scale = sqrt(sqrt(squared_norm(cofactor) / squared_norm(x)) / det);
    const Float8 of_x = 0.5f * scale, of_cofactor = 0.5f / (scale * det);
    Float8 change{};
    for (std::size_t k = 0; k < 9; ++k) {
      const Float8 next = of_x * x[k] + of_cofactor * cofactor[k];
      change += (next - x[k]) * (next - x[k]);
      x[k] = next;
    }
    if (bits(change > 1e-8f) == 0) break;  // quadratic: the next step would change 1e-8
  }
  Polar8 result{x, {}};
  const std::uint32_t done = bits(regular);
  for (int lane = 0; lane < static_cast<int>(kRingPack) && done != 0xff; ++lane) {
    if ((done >> lane & 1) == 0) decompose_lane(gradient, lane, result.rotation);
  }
  const Matrix8 &r = result.rotation, &t = gradient;
  const auto product = [&](std::size_t i, std::size_t j) {
    return r[i] * t[j] + r[3 + i] * t[3 + j] + r[6 + i] * t[6 + j];
  };
  const auto off = [&](std::size_t i, std::size_t j) { return 0.5f * (product(i, j) + product(j, i)); };
  result.stretch = {product(0, 0), off(0, 1), off(0, 2), product(1, 1), off(1, 2), product(2, 2)};
  return result;
}

Quaternion8 quaternions(const Matrix8& r) {
  // Four formulas, each exact up to its own factor; the largest factor loses nothing.
  const Quaternion8 squares = {1 + r[0] + r[4] + r[8], 1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8],
                               1 - r[0] - r[4] + r[8]};
  const Float8 wx = r[7] - r[5], wy = r[2] - r[6], wz = r[3] - r[1];
  const Float8 xy = r[1] + r[3], xz = r[2] + r[6], yz = r[5] + r[7];
  const Quaternion8 rows[4] = {
      {squares[0], wx, wy, wz}, {wx, squares[1], xy, xz}, {wy, xy, squares[2], yz}, {wz, xz, yz, squares[3]}};
  Quaternion8 q = rows[0];
  Float8 best = squares[0];
  for (std::size_t k = 1; k < 4; ++k) {
    const Int8 better = squares[k] > best;
    for (std::size_t c = 0; c < 4; ++c) q[c] = select(better, rows[k][c], q[c]);
    best = select(better, squares[k], best);
  }
  Float8 scale = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  scale = select(q[0] < 0, -scale, scale);
  for (Float8& c : q) c *= scale;
  return q;
}

Quaternion8 axes_and_angles(const Quaternion8& q) {
  const Float8 length = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const Float8 inverse = select(length > 1e-12f, 1 / max(length, broadcast8(1e-12f)), Float8{});
  return {q[1] * inverse, q[2] * inverse, q[3] * inverse, 2 * atan2(length, abs(q[0]))};
}

Matrix8 rotations_from_quaternions(const Quaternion8& q) {
  const Float8 length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  const Float8 s = select(length2 > 1e-20f, 2 / max(length2, broadcast8(1e-20f)), Float8{});
  const Float8 x = s * q[1], y = s * q[2], z = s * q[3];
  const Float8 xx = x * q[1], yy = y * q[2], zz = z * q[3], xy = x * q[2], xz = x * q[3], yz = y * q[3];
  const Float8 wx = x * q[0], wy = y * q[0], wz = z * q[0];
  return {1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy};
}

Matrix8 rotations_from_vectors(const Vector8& v) {
  // The quaternion's sign does not matter, so half the angle is reduced to [-pi/2, pi/2] by whole multiples of pi.
  const Float8 angle = sqrt(dot(v, v)), turns = round(angle * 0.15915494f);
  const Float8 x = (0.5f * angle - turns * 3.140625f) - turns * 9.6765358979e-4f, z = x * x;
  const Float8 sine =
      ((((-2.5052108e-8f * z + 2.7557319e-6f) * z - 1.9841270e-4f) * z + 8.3333333e-3f) * z - 1.6666667e-1f) * z * x +
      x;
  const Float8 cosine =
      (((((2.0876757e-9f * z - 2.7557319e-7f) * z + 2.4801587e-5f) * z - 1.3888889e-3f) * z + 4.1666667e-2f) * z -
       0.5f) *
          z +
      1;
  const Float8 per_angle = select(angle > 1e-6f, sine / max(angle, broadcast8(1e-6f)), broadcast8(0.5f));
  return rotations_from_quaternions({cosine, per_angle * v.x, per_angle * v.y, per_angle * v.z});
}

Matrix8 compose(const Matrix8& r, const std::array<Float8, 6>& s) {
  Matrix8 t;
  for (std::size_t row = 0; row < 3; ++row) {
    const Float8 a = r[3 * row], b = r[3 * row + 1], c = r[3 * row + 2];
    t[3 * row] = a * s[0] + b * s[1] + c * s[2];
    t[3 * row + 1] = a * s[1] + b * s[3] + c * s[4];
    t[3 * row + 2] = a * s[2] + b * s[4] + c * s[5];
  }
  return t;
}

}  // namespace pleat::conversion
