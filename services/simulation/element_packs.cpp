#include "services/simulation/element_packs.hpp"

#include <numbers>

namespace pleat::simulation {
namespace {

struct Vector8 {
  Float8 x, y, z;
};
Vector8 operator+(const Vector8& a, const Vector8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector8 operator-(const Vector8& a) { return {-a.x, -a.y, -a.z}; }
Vector8 operator*(Float8 s, const Vector8& a) { return {s * a.x, s * a.y, s * a.z}; }
Vector8 operator*(float s, const Vector8& a) { return {s * a.x, s * a.y, s * a.z}; }
Float8 dot(const Vector8& a, const Vector8& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vector8 cross(const Vector8& a, const Vector8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// to - from, in double before it is rounded.
Vector8 difference(const Double4* x, const std::array<std::uint32_t, kPack>& from,
                   const std::array<std::uint32_t, kPack>& to) {
  Float4 rows[kPack];
  for (std::size_t k = 0; k < kPack; ++k) rows[k] = __builtin_convertvector(x[to[k]] - x[from[k]], Float4);
  Float8 columns[4];
  transpose(rows, columns);
  return {columns[0], columns[1], columns[2]};
}

void locate(Float8 coordinate, Int8& index, Float8& fraction) {
  constexpr float kMost = StretchingTable::kSamples - 1;
  const Float8 x = min(max(coordinate * static_cast<float>(StretchingTable::kSamples), Float8{}), broadcast8(kMost));
  index = __builtin_convertvector(min(x, broadcast8(kMost - 1)), Int8);
  fraction = x - __builtin_convertvector(index, Float8);
}

struct Moduli8 {
  Float8 c11, c12, c22, c33;
};
Moduli8 moduli(const StretchingTable& table, Float8 g00, Float8 g11, Float8 g01) {
  constexpr auto kLowest = static_cast<float>(StretchingTable::kLowestStrain);
  constexpr int kSamples = StretchingTable::kSamples;
  Int8 i, j, k;
  Float8 fi, fj, fk;
  locate(g00 - kLowest, i, fi);
  locate(g11 - kLowest, j, fj);
  locate(abs(g01), k, fk);
  const Int8 cell = (i * kSamples + j) * kSamples + k;
  Float4 rows[kPack];
  for (int lane = 0; lane < static_cast<int>(kPack); ++lane) {
    const Moduli* m = table.samples() + cell[lane];
    const auto along_k = [&](int offset) {
      const Float4 low = load_as<Float4>(m + offset), high = load_as<Float4>(m + offset + 1);
      return low + fk[lane] * (high - low);
    };
    const Float4 low0 = along_k(0), high0 = along_k(kSamples);
    const Float4 low1 = along_k(kSamples * kSamples), high1 = along_k(kSamples * kSamples + kSamples);
    const Float4 low = low0 + fj[lane] * (high0 - low0), high = low1 + fj[lane] * (high1 - low1);
    rows[lane] = low + fi[lane] * (high - low);
  }
  Float8 columns[4];
  transpose(rows, columns);
  return {columns[0], columns[1], columns[2], columns[3]};
}

Vector8 air_force(const FacePack& pack, const Vector8& area_normal, const Air& air) {
  Float4 rows[kPack];
  for (std::size_t k = 0; k < kPack; ++k) {
    const Double4 sum = air.velocities[pack.v[0][k]] + air.velocities[pack.v[1][k]] + air.velocities[pack.v[2][k]];
    rows[k] = to_float4(air.wind) - __builtin_convertvector(sum / 3, Float4);
  }
  Float8 columns[4];
  transpose(rows, columns);
  const Vector8 relative{columns[0], columns[1], columns[2]};
  const Vector8 n = (1 / max(sqrt(dot(area_normal, area_normal)), broadcast8(1e-30f))) * area_normal;
  const Float8 along = dot(relative, n), largest = air.largest * pack.area;
  const Float8 pressure = min(air.density * pack.area * abs(along), largest);
  const Float8 drag = min(air.drag * pack.area, largest);
  return (pressure * along - drag * along) * n + drag * relative;
}

// Writes values[first..first + 8) of every lane to its record.
template <std::size_t kRecord>
void store_columns(const Float8* values, std::size_t first, float* records) {
  Float8 rows[8], lanes[8];
  for (std::size_t k = 0; k < 8; ++k) rows[k] = values[first + k];
  transpose(rows, lanes);
  for (std::size_t lane = 0; lane < kPack; ++lane) store_to(records + lane * kRecord + first, lanes[lane]);
}

}  // namespace

void FacePack::set(std::size_t lane, const std::array<std::uint32_t, 3>& vertices, const TriangleRest<float>& rest) {
  for (std::size_t k = 0; k < 3; ++k) v[k][lane] = vertices[k];
  const auto l = static_cast<int>(lane);
  du1[l] = rest.du[1];
  du2[l] = rest.du[2];
  dv1[l] = rest.dv[1];
  dv2[l] = rest.dv[2];
  area[l] = rest.area;
}

void HingePack::set(std::size_t lane, const std::array<std::uint32_t, 4>& vertices, const HingeRest<float>& rest) {
  for (std::size_t k = 0; k < 4; ++k) v[k][lane] = vertices[k];
  const auto l = static_cast<int>(lane);
  shape[l] = rest.shape;
  curvature_per_radian[l] = rest.curvature_per_radian;
  for (std::size_t k = 0; k < 5; ++k) stiffness[k][l] = rest.stiffness[k];
}

void stretching_pack(const FacePack& pack, const Double4* x, const StretchingTable& table, const Air* air,
                     float* records) {
  const Vector8 e1 = difference(x, pack.v[0], pack.v[1]), e2 = difference(x, pack.v[0], pack.v[2]);
  const Vector8 xu = pack.du1 * e1 + pack.du2 * e2, xv = pack.dv1 * e1 + pack.dv2 * e2;
  const Float8 g00 = (dot(xu, xu) - 1) * 0.5f, g11 = (dot(xv, xv) - 1) * 0.5f, g01 = dot(xu, xv) * 0.5f;
  const Moduli8 k = moduli(table, g00, g11, g01);

  const Float8 s00 = k.c11 * g00 + k.c12 * g11, s11 = k.c12 * g00 + k.c22 * g11, s01 = k.c33 * g01;
  const Vector8 pu = -pack.area * (s00 * xu + s01 * xv), pv = -pack.area * (s01 * xu + s11 * xv);
  Vector8 f1 = pack.du1 * pu + pack.dv1 * pv, f2 = pack.du2 * pu + pack.dv2 * pv, f0 = -(f1 + f2);
  if (air != nullptr) {
    const Vector8 third = (1.0f / 3) * air_force(pack, cross(e1, e2), *air);
    f0 = f0 + third;
    f1 = f1 + third;
    f2 = f2 + third;
  }

  // The parts of the stiffness: uu = muu, vv = mvv, uv = muv of stretching_stiffness().
  const Float8 u[3] = {xu.x, xu.y, xu.z}, v[3] = {xv.x, xv.y, xv.z};
  const Float8 tension_u = max(g00, Float8{}), tension_v = max(g11, Float8{});
  const Float8 half_shear = 0.5f * k.c33;
  const Float8 pull_u = pack.area * (k.c11 * tension_u + k.c12 * tension_v);
  const Float8 pull_v = pack.area * (k.c22 * tension_v + k.c12 * tension_u);
  const Float8 a11 = pack.area * k.c11, a22 = pack.area * k.c22, a12 = pack.area * k.c12, a33 = pack.area * half_shear;
  Float8 uu[3][3], vv[3][3], uv[3][3];
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) {
      const Float8 u_u = u[r] * u[c], v_v = v[r] * v[c];
      uu[r][c] = a11 * u_u + a33 * v_v;
      vv[r][c] = a22 * v_v + a33 * u_u;
      uv[r][c] = a12 * u[r] * v[c] + a33 * v[r] * u[c];
    }
    uu[r][r] += pull_u;
    vv[r][r] += pull_v;
  }
  const Float8 du[3] = {-pack.du1 - pack.du2, pack.du1, pack.du2}, dv[3] = {-pack.dv1 - pack.dv2, pack.dv1, pack.dv2};
  Float8 values[kFaceRecord] = {};
  for (std::size_t e = 0; e < 3; ++e) {
    const std::size_t a = e, b = (e + 1) % 3;
    const Float8 w_uu = du[a] * du[b], w_vv = dv[a] * dv[b], w_uv = du[a] * dv[b], w_vu = dv[a] * du[b];
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t r = 0; r < 3; ++r) {
        values[9 * e + 3 * c + r] = w_uu * uu[r][c] + w_vv * vv[r][c] + w_uv * uv[r][c] + w_vu * uv[c][r];
      }
    }
  }
  const Float8 forces[9] = {f0.x, f0.y, f0.z, f1.x, f1.y, f1.z, f2.x, f2.y, f2.z};
  for (std::size_t n = 0; n < 9; ++n) values[kFaceForces + n] = forces[n];
  for (std::size_t first = 0; first < kFaceRecord; first += 8) store_columns<kFaceRecord>(values, first, records);
}

void bending_pack(const HingePack& pack, const Double4* x, float* reference_angles, float* records) {
  const Vector8 edge = difference(x, pack.v[0], pack.v[1]), wing0 = difference(x, pack.v[0], pack.v[2]),
                wing1 = difference(x, pack.v[0], pack.v[3]);
  const Float8 tiny = broadcast8(1e-18f);
  const Float8 length2 = max(dot(edge, edge), tiny), length = sqrt(length2);
  const Vector8 n0 = cross(edge, wing0), n1 = cross(wing1, edge);
  const Float8 size0 = max(sqrt(dot(n0, n0)), tiny), size1 = max(sqrt(dot(n1, n1)), tiny);
  const Vector8 unit0 = (1 / size0) * n0, unit1 = (1 / size1) * n1;
  Float8 theta = atan2(dot(edge, cross(unit0, unit1)) / length, dot(unit0, unit1));
  constexpr float kTurn = 2 * std::numbers::pi_v<float>;
  theta += kTurn * round((load_as<Float8>(reference_angles) - theta) * (1 / kTurn));
  store_to(reference_angles, theta);

  const Float8 floor = 1e-3f * length;
  const Float8 t0 = dot(wing0, edge) / length2, t1 = dot(wing1, edge) / length2;
  const Vector8 g2 = (-1 / max(size0 / length, floor)) * unit0, g3 = (-1 / max(size1 / length, floor)) * unit1;
  const Vector8 g0 = -((1 - t0) * g2 + (1 - t1) * g3), g1 = -(t0 * g2 + t1 * g3);

  const Float8 q = min(0.1f * abs(theta * pack.curvature_per_radian), broadcast8(4));
  Float8 stiffness = pack.stiffness[0];
  for (std::size_t j = 0; j < 4; ++j) {
    const Float8 part = min(max(q - static_cast<float>(j), Float8{}), broadcast8(1));
    stiffness += part * (pack.stiffness[j + 1] - pack.stiffness[j]);
  }
  const Float8 root = sqrt(stiffness * pack.shape * 0.5f);
  const Vector8 gradients[4] = {root * g0, root * g1, root * g2, root * g3};
  Float8 values[kHingeRecord] = {};
  for (std::size_t k = 0; k < 4; ++k) {
    values[4 * k] = gradients[k].x;
    values[4 * k + 1] = gradients[k].y;
    values[4 * k + 2] = gradients[k].z;
  }
  values[3] = -root * theta;
  store_columns<kHingeRecord>(values, 0, records);
  store_columns<kHingeRecord>(values, 8, records);
}

}  // namespace pleat::simulation
