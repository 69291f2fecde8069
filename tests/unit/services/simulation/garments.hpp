// Small garments and scenes for tests.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// A rectangle in the plane y = 0 of nx x nz cells, normals up (+y), centred at the origin; u = x, v = -z.
inline Topology sheet(int nx, int nz, double width, double depth) {
  Topology t;
  t.rest_positions.resize((nx + 1) * (nz + 1), 3);
  t.uv.resize(t.rest_positions.rows(), 2);
  for (int j = 0; j <= nz; ++j) {
    for (int i = 0; i <= nx; ++i) {
      const auto x = static_cast<float>(width * (static_cast<double>(i) / nx - 0.5));
      const auto z = static_cast<float>(depth * (static_cast<double>(j) / nz - 0.5));
      t.rest_positions.row(j * (nx + 1) + i) << x, 0, z;
      t.uv.row(j * (nx + 1) + i) << x, -z;
    }
  }
  t.faces.resize(2 * nx * nz, 3);
  for (int j = 0; j < nz; ++j) {
    for (int i = 0; i < nx; ++i) {
      const auto a = static_cast<std::uint32_t>(j * (nx + 1) + i), b = a + 1;
      const std::uint32_t c = a + static_cast<std::uint32_t>(nx) + 1, d = c + 1;
      t.faces.row(2 * (j * nx + i)) << a, c, b;
      t.faces.row(2 * (j * nx + i) + 1) << b, c, d;
    }
  }
  t.uv_faces = t.faces;
  return t;
}

/// A closed cube about the origin.
inline Topology box_mesh(double size) {
  Topology t;
  t.rest_positions.resize(8, 3);
  for (int v = 0; v < 8; ++v) {
    for (int k = 0; k < 3; ++k) t.rest_positions(v, k) = static_cast<float>(size * ((v >> k & 1) ? 0.5 : -0.5));
  }
  t.faces.resize(12, 3);
  t.faces << 0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5;
  return t;
}

/// The same stiffness in all directions and at all strains: c11 = c22 = modulus / 2 in the file's terms, no coupling.
inline Material plain_material(double modulus, double bending) {
  Material m;
  m.density = 0.2;
  for (auto& row : m.stretching) row = {modulus / 2, 0, modulus / 2, modulus / 2};
  for (auto& row : m.bending) row.fill(bending);
  return m;
}

inline Handle handle_on(std::vector<std::uint32_t> vertices, double start_s = 0, double end_s = 1e30) {
  Handle handle;
  handle.vertices = std::move(vertices);
  handle.start_s = start_s;
  handle.end_s = end_s;
  return handle;
}

inline Scene sheet_scene(int cells = 8) {
  Scene scene;
  scene.name = "test";
  scene.garment = sheet(cells, cells, 0.5, 0.5);
  scene.material = plain_material(60, 2e-5);
  scene.frames = 1000;
  scene.threads = 1;
  return scene;
}

}  // namespace pleat::simulation
