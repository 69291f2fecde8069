// What the tests of the physics share: materials with known moduli, and scenes of one mesh.
#pragma once

#include <numbers>
#include <utility>

#include "common/mesh/mesh.hpp"
#include "services/simulation/dynamics.hpp"
#include "services/simulation/material.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

inline constexpr double kGravity = 9.81;
inline constexpr double kPi = std::numbers::pi;

/// In the file's terms: an isotropic sheet of membrane stiffness E t (N/m) and Poisson's ratio nu. All rows are equal,
/// so that the moduli do not depend on the strain.
inline Material isotropic_material(double membrane, double poisson, double bending, double density) {
  Material m;
  m.density = density;
  const double c11 = membrane / (2 * (1 - poisson * poisson));
  for (auto& row : m.stretching) row = {c11, poisson * c11, c11, membrane / (2 * (1 + poisson))};
  for (auto& row : m.bending) row.fill(bending);
  return m;
}

/// Positions as the solver has them.
inline Points to_points(const Positions& positions) {
  Points x;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) x.push_back(positions.row(v).cast<double>().transpose());
  return x;
}

/// Without air.
inline Scene mesh_scene(Topology garment, Material material) {
  Scene scene;
  scene.name = "physics";
  scene.garment = std::move(garment);
  scene.material = material;
  scene.frames = 100'000;
  scene.threads = 1;
  scene.wind.density = 0;
  return scene;
}

}  // namespace pleat::simulation
