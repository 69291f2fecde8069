// Sheets and what is done to them, for the tests of vertex features.
#pragma once

#include <cmath>
#include <functional>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/conversion/vertex_features/extraction.hpp"

namespace pleat::test {

inline constexpr float kPi = std::numbers::pi_v<float>;

/// A flat sheet in x and z, `side` vertices a side, edges of `edge_m`. Triangles: all diagonals alike.
inline Topology sheet(int wide, int high, float edge_m) {
  Topology t;
  t.rest_positions.resize(static_cast<Eigen::Index>(wide) * high, 3);
  t.faces.resize(2 * static_cast<Eigen::Index>(wide - 1) * (high - 1), 3);
  const auto at = [&](int i, int j) { return static_cast<std::uint32_t>(i * high + j); };
  Eigen::Index face = 0;
  for (int i = 0; i < wide; ++i) {
    for (int j = 0; j < high; ++j) {
      t.rest_positions.row(at(i, j)) << static_cast<float>(i) * edge_m, 0, static_cast<float>(j) * edge_m;
      if (i + 1 == wide || j + 1 == high) continue;
      t.faces.row(face++) << at(i, j), at(i, j + 1), at(i + 1, j);
      t.faces.row(face++) << at(i + 1, j), at(i, j + 1), at(i + 1, j + 1);
    }
  }
  return t;
}

inline Positions deform(const Topology& topology, const std::function<Eigen::Vector3f(const Eigen::Vector3f&)>& map) {
  Positions result(topology.vertex_count(), 3);
  for (Eigen::Index v = 0; v < topology.vertex_count(); ++v) {
    const Eigen::Vector3f rest = topology.rest_positions.row(v);
    result.row(v) = map(rest);
  }
  return result;
}

inline Eigen::Vector3f waves(const Eigen::Vector3f& p) {
  return p + Eigen::Vector3f(0.01f * std::sin(9 * p.z()), 0.03f * std::sin(14 * p.x() + 5 * p.z()),
                             0.01f * std::sin(11 * p.x()));
}

inline std::shared_ptr<const conversion::OneRings> rings_of(const Topology& topology) {
  return std::make_shared<const conversion::OneRings>(topology, "mesh");
}

inline std::vector<Float4> registers(const Positions& positions) {
  std::vector<Float4> result;
  conversion::load_positions(positions, static_cast<std::size_t>(positions.rows()), 0, Eigen::Vector3f::Zero(), "mesh",
                             result);
  return result;
}

inline conversion::GradientField gradients_of(const conversion::OneRings& rings, const Positions& positions) {
  conversion::GradientField field;
  rings.gradients(registers(positions).data(), field);
  return field;
}

/// Edges whose ends' principal logarithms are more than pi apart.
inline std::size_t torn_by_principal_logarithms(const conversion::OneRings& rings,
                                                const conversion::ExtractedFrame& frame) {
  std::size_t torn = 0;
  for (const auto& e : rings.edges()) {
    const Float4 a = frame.rotations[e.a] * frame.rotations[e.a][3], b = frame.rotations[e.b] * frame.rotations[e.b][3];
    torn += std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) > kPi ? 1 : 0;
  }
  return torn;
}

}  // namespace pleat::test
