// Eight vectors and matrices at a time. Internal to this library.
#pragma once

#include "services/conversion/vertex_features/one_rings.hpp"

namespace pleat::conversion {

struct Vector8 {
  Float8 x, y, z;
};
inline Vector8 operator+(const Vector8& a, const Vector8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector8 operator*(Float8 s, const Vector8& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Float8 dot(const Vector8& a, const Vector8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector8 cross(const Vector8& a, const Vector8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// Eight quaternions (w, x, y, z).
using Quaternion8 = std::array<Float8, 4>;

inline float dot4(Float4 a, Float4 b) {
  const Float4 p = a * b;
  return (p[0] + p[1]) + (p[2] + p[3]);
}

/// to[k] = the lanes k of the four inputs, for the first `count` lanes.
inline void scatter_lanes(const Quaternion8& columns, Float4* to, std::size_t count) {
  const Float8 rows[8] = {columns[0], columns[1], columns[2], columns[3]};
  Float8 lanes[8];
  transpose(rows, lanes);
  for (std::size_t k = 0; k < count; ++k) to[k] = __builtin_shufflevector(lanes[k], lanes[k], 0, 1, 2, 3);
}

/// Writes eight gradients to the field's vertices from `first` on, as far as it has any.
inline void store_gradients(const Matrix8& t, std::size_t first, GradientField& field) {
  const Float8 left[8] = {t[0], t[3], t[6], Float8{}, t[1], t[4], t[7], Float8{}};
  const Float8 right[8] = {t[2], t[5], t[8]};
  Float8 columns01[8], column2[8];
  transpose(left, columns01);
  transpose(right, column2);
  const std::size_t count = std::min(kRingPack, field.columns.size() - first);
  for (std::size_t k = 0; k < count; ++k) {
    field.columns[first + k] = {__builtin_shufflevector(columns01[k], columns01[k], 0, 1, 2, 3),
                                __builtin_shufflevector(columns01[k], columns01[k], 4, 5, 6, 7),
                                __builtin_shufflevector(column2[k], column2[k], 0, 1, 2, 3)};
  }
}

/// Eight values from a plane, the last one repeated beyond its end.
inline Float8 load_lanes(const float* plane, std::size_t first, std::size_t count) {
  if (first + kRingPack <= count) return load_as<Float8>(plane + first);
  Float8 value;
  for (std::size_t k = 0; k < kRingPack; ++k) value[static_cast<int>(k)] = plane[std::min(first + k, count - 1)];
  return value;
}
inline void store_lanes(Float8 value, float* plane, std::size_t first, std::size_t count) {
  if (first + kRingPack <= count) return store_to(plane + first, value);
  for (std::size_t k = 0; first + k < count; ++k) plane[first + k] = value[static_cast<int>(k)];
}

}  // namespace pleat::conversion
