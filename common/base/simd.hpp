// Short vectors of floats (the compiler's vector extension: no intrinsics, any processor).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <cstring>

namespace pleat {

using Float4 = float __attribute__((vector_size(16)));
using Float8 = float __attribute__((vector_size(32)));
using Int4 = std::int32_t __attribute__((vector_size(16)));
using Int8 = std::int32_t __attribute__((vector_size(32)));
using Double4 = double __attribute__((vector_size(32)));

template <typename Vector, typename Scalar>
Vector load_as(const Scalar* from) {
  Vector v;
  std::memcpy(&v, from, sizeof(v));
  return v;
}
template <typename Vector, typename Scalar>
void store_to(Scalar* to, const Vector& v) {
  std::memcpy(to, &v, sizeof(v));
}

inline Float4 min(Float4 a, Float4 b) { return a < b ? a : b; }
inline Float4 max(Float4 a, Float4 b) { return a > b ? a : b; }
inline Float8 min(Float8 a, Float8 b) { return a < b ? a : b; }
inline Float8 max(Float8 a, Float8 b) { return a > b ? a : b; }
inline Float4 broadcast4(float value) { return Float4{value, value, value, value}; }
inline Float8 broadcast8(float value) { return Float8{value, value, value, value, value, value, value, value}; }

/// Whether any lane of a comparison's result is set.
inline bool any(Int4 mask) {
  using Halves = long long __attribute__((vector_size(16)));
  const auto halves = reinterpret_cast<Halves>(mask);
  return (halves[0] | halves[1]) != 0;
}
/// One bit per lane of a comparison's result.
inline std::uint32_t bits(Int8 mask) {
#ifdef __AVX__
  return static_cast<std::uint32_t>(__builtin_ia32_movmskps256(reinterpret_cast<Float8>(mask)));
#else
  std::uint32_t result = 0;
  for (int lane = 0; lane < 8; ++lane) result |= (mask[lane] != 0 ? 1u : 0u) << lane;
  return result;
#endif
}

inline Float8 abs(Float8 a) { return max(a, -a); }
inline Float8 select(Int8 mask, Float8 yes, Float8 no) { return mask ? yes : no; }
inline Float8 sqrt(Float8 a) {
#ifdef __AVX__
  return __builtin_ia32_sqrtps256(a);
#else
  for (int lane = 0; lane < 8; ++lane) a[lane] = __builtin_sqrtf(a[lane]);
  return a;
#endif
}
/// To the nearest integer; for |a| below 4 million.
inline Float8 round(Float8 a) {
  const Float8 magic = broadcast8(12582912.0f);
  return (a + magic) - magic;
}

/// Angle of (x, y) in (-pi, pi], within 3e-7; 0 for (0, 0). One reduction to |t| <= tan(pi/8), then Cephes' polynomial.
inline Float8 atan2(Float8 y, Float8 x) {
  const Float8 ax = abs(x), ay = abs(y);
  const Float8 a = min(ax, ay) / max(max(ax, ay), broadcast8(1e-37f));
  const Int8 large = a > 0.41421356f;
  const Float8 t = select(large, (a - 1) / (a + 1), a), z = t * t;
  Float8 r =
      (((8.05374449538e-2f * z - 1.38776856032e-1f) * z + 1.99777106478e-1f) * z - 3.33329491539e-1f) * z * t + t;
  r += select(large, broadcast8(0.785398163f), Float8{});
  r = select(ay > ax, 1.57079633f - r, r);
  r = select(x < 0, 3.14159265f - r, r);
  return select(y < 0, -r, r);
}

/// Rows 0-3 of the result are the lanes of the eight inputs: out[c][k] = rows[k][c].
inline void transpose(const Float4 (&rows)[8], Float8 (&out)[4]) {
  Float8 a[4];
  for (int k = 0; k < 4; ++k) a[k] = __builtin_shufflevector(rows[k], rows[k + 4], 0, 1, 2, 3, 4, 5, 6, 7);
  const Float8 t0 = __builtin_shufflevector(a[0], a[1], 0, 8, 1, 9, 4, 12, 5, 13);
  const Float8 t1 = __builtin_shufflevector(a[0], a[1], 2, 10, 3, 11, 6, 14, 7, 15);
  const Float8 t2 = __builtin_shufflevector(a[2], a[3], 0, 8, 1, 9, 4, 12, 5, 13);
  const Float8 t3 = __builtin_shufflevector(a[2], a[3], 2, 10, 3, 11, 6, 14, 7, 15);
  out[0] = __builtin_shufflevector(t0, t2, 0, 1, 8, 9, 4, 5, 12, 13);
  out[1] = __builtin_shufflevector(t0, t2, 2, 3, 10, 11, 6, 7, 14, 15);
  out[2] = __builtin_shufflevector(t1, t3, 0, 1, 8, 9, 4, 5, 12, 13);
  out[3] = __builtin_shufflevector(t1, t3, 2, 3, 10, 11, 6, 7, 14, 15);
}
/// out[k][c] = rows[c][k].
inline void transpose(const Float8 (&rows)[8], Float8 (&out)[8]) {
  Float8 t[8], u[8];
  for (int k = 0; k < 8; k += 2) {
    t[k] = __builtin_shufflevector(rows[k], rows[k + 1], 0, 8, 1, 9, 4, 12, 5, 13);
    t[k + 1] = __builtin_shufflevector(rows[k], rows[k + 1], 2, 10, 3, 11, 6, 14, 7, 15);
  }
  for (int k = 0; k < 8; k += 4) {
    u[k] = __builtin_shufflevector(t[k], t[k + 2], 0, 1, 8, 9, 4, 5, 12, 13);
    u[k + 1] = __builtin_shufflevector(t[k], t[k + 2], 2, 3, 10, 11, 6, 7, 14, 15);
    u[k + 2] = __builtin_shufflevector(t[k + 1], t[k + 3], 0, 1, 8, 9, 4, 5, 12, 13);
    u[k + 3] = __builtin_shufflevector(t[k + 1], t[k + 3], 2, 3, 10, 11, 6, 7, 14, 15);
  }
  for (int k = 0; k < 4; ++k) {
    out[k] = __builtin_shufflevector(u[k], u[k + 4], 0, 1, 2, 3, 8, 9, 10, 11);
    out[k + 4] = __builtin_shufflevector(u[k], u[k + 4], 4, 5, 6, 7, 12, 13, 14, 15);
  }
}

template <typename Derived>
Float4 to_float4(const Eigen::MatrixBase<Derived>& expression) {
  Eigen::Vector3f v;
  v = expression.template cast<float>();
  return Float4{v.x(), v.y(), v.z(), 0};
}

}  // namespace pleat
