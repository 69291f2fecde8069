// Rotation and stretch of a 3 x 3 matrix, eight at a time.
#pragma once

#include "services/conversion/vertex_features/vectors.hpp"

namespace pleat::conversion {

/// T = R S with R a proper rotation and S symmetric. S has one negative eigenvalue, that of the smallest magnitude,
/// where det T < 0.
struct Polar8 {
  Matrix8 rotation;
  std::array<Float8, 6> stretch;  ///< S's upper triangle by rows
};

/// Scaled Newton iteration X <- (g X + (g X)^-T) / 2, g^2 = |X^-1| / |X|; lanes where T is nearly singular or
/// reflected get a singular value decomposition in double. Finite for every finite T.
Polar8 polar_decomposition(const Matrix8& gradient);

/// Unit quaternions with w >= 0.
Quaternion8 quaternions(const Matrix8& rotation);

/// (axis, angle) with a unit axis (0 where there is no rotation) and an angle in [0, pi]. The angle is
/// 2 atan2(|im q|, |re q|): acos of the trace is useless near pi.
Quaternion8 axes_and_angles(const Quaternion8& quaternion);

/// The rotations exp(v), for |v| up to 1e3.
Matrix8 rotations_from_vectors(const Vector8& v);
/// The rotations of quaternions of any length; the identity for (almost) none.
Matrix8 rotations_from_quaternions(const Quaternion8& quaternion);

/// R S, S by its upper triangle.
Matrix8 compose(const Matrix8& rotation, const std::array<Float8, 6>& stretch);

}  // namespace pleat::conversion
