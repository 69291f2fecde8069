// The elements of services/simulation/elements.hpp eight at a time, for the rivals: what the engine has in
// element_packs.cpp, without the parts that only an assembled matrix needs.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/simd.hpp"
#include "services/fold/lanes.hpp"
#include "services/simulation/elements.hpp"

namespace pleat::bench {

using fold::dot;
using fold::from_rows;
using fold::independent_packs;
using fold::kLanes;
using fold::Lanes;
using fold::Vector8;

inline Vector8 operator+(const Vector8& a, const Vector8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector8 operator-(const Vector8& a, const Vector8& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector8 operator*(Float8 s, const Vector8& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Vector8 cross(const Vector8& a, const Vector8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// x[to] - x[from], subtracted in double.
inline Vector8 difference(const std::vector<Double4>& x, const Lanes& from, const Lanes& to) {
  Float4 rows[kLanes];
  for (std::size_t k = 0; k < kLanes; ++k) rows[k] = __builtin_convertvector(x[to[k]] - x[from[k]], Float4);
  return from_rows(rows);
}
/// Calls use(lane, row) with the vector of each lane.
template <typename Use>
void for_each_lane(const Vector8& v, const Use& use) {
  const Float8 columns[8] = {v.x, v.y, v.z, {}, {}, {}, {}, {}};
  Float8 rows[8];
  transpose(columns, rows);
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    use(lane, __builtin_shufflevector(rows[lane], rows[lane], 0, 1, 2, 3));
  }
}
/// x[v] += delta, lane by lane: lanes may name a vertex again only where the order does not matter.
inline void add_to(std::vector<Double4>& x, const Lanes& v, const Vector8& delta) {
  for_each_lane(delta, [&](std::size_t lane, Float4 row) { x[v[lane]] += __builtin_convertvector(row, Double4); });
}

struct Face8 {
  std::array<Lanes, 3> v{};
  std::array<Float8, 3> du{}, dv{};  // gradients of the shape functions, 1/m
  Float8 area{};

  /// All lanes without element: at a vertex that nothing reads.
  explicit Face8(std::uint32_t nowhere) {
    for (Lanes& lanes : v) lanes.fill(nowhere);
  }
  void set(std::size_t lane, const std::array<std::uint32_t, 3>& vertices,
           const simulation::TriangleRest<float>& rest) {
    const auto l = static_cast<int>(lane);
    for (std::size_t k = 0; k < 3; ++k) {
      v[k][lane] = vertices[k];
      du[k][l] = rest.du[k];
      dv[k][l] = rest.dv[k];
    }
    area[l] = rest.area;
  }
};

struct Hinge8 {
  std::array<Lanes, 4> v{};
  Float8 shape{}, curvature_per_radian{};
  std::array<Float8, 5> stiffness{};

  explicit Hinge8(std::uint32_t nowhere) {
    for (Lanes& lanes : v) lanes.fill(nowhere);
  }
  void set(std::size_t lane, const std::array<std::uint32_t, 4>& vertices, const simulation::HingeRest<float>& rest) {
    const auto l = static_cast<int>(lane);
    for (std::size_t k = 0; k < 4; ++k) v[k][lane] = vertices[k];
    shape[l] = rest.shape;
    curvature_per_radian[l] = rest.curvature_per_radian;
    for (std::size_t k = 0; k < 5; ++k) stiffness[k][l] = rest.stiffness[k];
  }
};

struct Moduli8 {
  Float8 c11, c12, c22, c33;
};
/// The material's table at eight strains (StretchingTable::at).
inline Moduli8 moduli_at(const simulation::StretchingTable& table, Float8 g00, Float8 g11, Float8 g01) {
  constexpr int kSamples = simulation::StretchingTable::kSamples;
  const auto locate = [](Float8 coordinate, Int8& index, Float8& fraction) {
    const Float8 x = min(max(coordinate * static_cast<float>(kSamples), Float8{}), broadcast8(kSamples - 1));
    index = __builtin_convertvector(min(x, broadcast8(kSamples - 2)), Int8);
    fraction = x - __builtin_convertvector(index, Float8);
  };
  Int8 i, j, k;
  Float8 fi, fj, fk;
  const auto lowest = static_cast<float>(simulation::StretchingTable::kLowestStrain);
  locate(g00 - lowest, i, fi);
  locate(g11 - lowest, j, fj);
  locate(abs(g01), k, fk);
  const Int8 cell = (i * kSamples + j) * kSamples + k;
  Float4 rows[kLanes];
  for (int lane = 0; lane < static_cast<int>(kLanes); ++lane) {
    const auto along_k = [&](int offset) {
      const simulation::Moduli* m = table.samples() + cell[lane] + offset;
      const Float4 low = load_as<Float4>(m), high = load_as<Float4>(m + 1);
      return low + fk[lane] * (high - low);
    };
    const auto along_j = [&](int offset) {
      const Float4 low = along_k(offset), high = along_k(offset + kSamples);
      return low + fj[lane] * (high - low);
    };
    const Float4 low = along_j(0), high = along_j(kSamples * kSamples);
    rows[lane] = low + fi[lane] * (high - low);
  }
  Float8 columns[4];
  transpose(rows, columns);
  return {columns[0], columns[1], columns[2], columns[3]};
}

/// Green strain of eight faces, the tangents it comes from, and the moduli at it.
struct Strain8 {
  Vector8 xu, xv;
  Float8 g00, g11, g01;
  Moduli8 moduli;

  Strain8(const Face8& face, const std::vector<Double4>& x, const simulation::StretchingTable& table) {
    const Vector8 e1 = difference(x, face.v[0], face.v[1]), e2 = difference(x, face.v[0], face.v[2]);
    xu = face.du[1] * e1 + face.du[2] * e2;
    xv = face.dv[1] * e1 + face.dv[2] * e2;
    g00 = (dot(xu, xu) - 1) * 0.5f;
    g11 = (dot(xv, xv) - 1) * 0.5f;
    g01 = dot(xu, xv) * 0.5f;
    moduli = moduli_at(table, g00, g11, g01);
  }
};

/// Angle of eight hinges, its gradient at their vertices (as hinge_angle()), and the stiffness k of k/2 theta^2.
struct Angle8 {
  Float8 theta, stiffness;
  std::array<Vector8, 4> gradient;

  Angle8(const Hinge8& hinge, const std::vector<Double4>& x) {
    const Vector8 edge = difference(x, hinge.v[0], hinge.v[1]), wing0 = difference(x, hinge.v[0], hinge.v[2]),
                  wing1 = difference(x, hinge.v[0], hinge.v[3]);
    const Float8 tiny = broadcast8(1e-18f);
    const Float8 length2 = max(dot(edge, edge), tiny), length = sqrt(length2);
    const Vector8 n0 = cross(edge, wing0), n1 = cross(wing1, edge);
    const Float8 size0 = max(sqrt(dot(n0, n0)), tiny), size1 = max(sqrt(dot(n1, n1)), tiny);
    const Vector8 unit0 = (1 / size0) * n0, unit1 = (1 / size1) * n1;
    theta = atan2(dot(edge, cross(unit0, unit1)) / length, dot(unit0, unit1));
    const Float8 floor = 1e-3f * length;
    const Float8 t0 = dot(wing0, edge) / length2, t1 = dot(wing1, edge) / length2;
    gradient[2] = (-1 / max(size0 / length, floor)) * unit0;
    gradient[3] = (-1 / max(size1 / length, floor)) * unit1;
    gradient[0] = (t0 - 1) * gradient[2] + (t1 - 1) * gradient[3];
    gradient[1] = -t0 * gradient[2] - t1 * gradient[3];
    const Float8 q = min(0.1f * abs(theta * hinge.curvature_per_radian), broadcast8(4));
    Float8 ke = hinge.stiffness[0];
    for (std::size_t j = 0; j < 4; ++j) {
      const Float8 part = min(max(q - static_cast<float>(j), Float8{}), broadcast8(1));
      ke += part * (hinge.stiffness[j + 1] - hinge.stiffness[j]);
    }
    stiffness = ke * hinge.shape * 0.5f;
  }
};

}  // namespace pleat::bench
