#include "services/simulation/dynamics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

Points points_of(const Topology& t) {
  Points x;
  for (Eigen::Index v = 0; v < t.vertex_count(); ++v) x.push_back(t.rest_positions.row(v).cast<double>().transpose());
  return x;
}

TEST(Dynamics, MassesAndAreasAddUp) {
  const Scene scene = sheet_scene();
  const Dynamics dynamics(scene.garment, scene);
  double mass = 0, area = 0;
  for (const double m : dynamics.masses()) mass += m;
  for (const double a : dynamics.areas()) area += a;
  EXPECT_NEAR(area, 0.25, 1e-6);
  EXPECT_NEAR(mass, 0.25 * 0.2, 1e-6);
}

TEST(Dynamics, RestAndRigidMotionHaveNoForces) {
  const Scene scene = sheet_scene();
  const Dynamics dynamics(scene.garment, scene);
  Points x = points_of(scene.garment);
  const Eigen::Matrix3d turn = rotation_matrix({0.3, -1.2, 0.7});
  for (Vector3d& p : x) p = turn * p + Vector3d(1, 2, 3);
  for (const Vector3d& f : dynamics.internal_forces(x)) EXPECT_LT(f.norm(), 1e-5);
  EXPECT_NEAR(dynamics.internal_energy(x), 0, 1e-9);
}

TEST(Dynamics, InternalForcesBalance) {
  Scene scene = sheet_scene();
  scene.material = read_material("deploy/materials/gray-interlock.json");
  const Dynamics dynamics(scene.garment, scene);
  Points x = points_of(scene.garment);
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> noise(-0.01, 0.01);
  for (Vector3d& p : x) p += Vector3d(noise(engine), noise(engine), noise(engine));
  Vector3d force = Vector3d::Zero(), torque = Vector3d::Zero();
  double size = 0;
  const Points forces = dynamics.internal_forces(x);
  for (std::size_t v = 0; v < x.size(); ++v) {
    force += forces[v];
    torque += x[v].cross(forces[v]);
    size += forces[v].norm();
  }
  EXPECT_GT(size, 1);
  EXPECT_LT(force.norm(), 1e-5 * size);
  EXPECT_LT(torque.norm(), 1e-5 * size);
}

TEST(Dynamics, UniaxialStretchPullsAsTheTableSays) {
  Scene scene = sheet_scene();
  scene.material = read_material("deploy/materials/gray-interlock.json");
  const Dynamics dynamics(scene.garment, scene);
  const StretchingTable table(scene.material, 1);
  for (const double stretch : {1.05, 1.1, 1.3}) {
    Points x = points_of(scene.garment);
    for (Vector3d& p : x) p.x() *= stretch;
    const Points forces = dynamics.internal_forces(x);
    double pull = 0;
    for (std::size_t v = 0; v < x.size(); ++v) {
      if (scene.garment.rest_positions(static_cast<Eigen::Index>(v), 0) > 0.249f) pull += forces[v].x();
    }
    const double g = (stretch * stretch - 1) / 2;
    const double expected = -0.5 * stretch * static_cast<double>(table.at(g, 0, 0).c11) * g;  // width times F S
    EXPECT_NEAR(pull, expected, 1e-3 * std::abs(expected)) << stretch;
  }
}

TEST(Dynamics, SecondLevelAddsItsForcesAndNoMass) {
  const Scene scene = sheet_scene(4);
  const Subdivision s = subdivide(scene.garment, 2);
  const Dynamics one(s.fine, scene), two(s.fine, scene, &scene.garment, s.feature_vertices),
      coarse(scene.garment, scene);
  EXPECT_EQ(one.masses(), two.masses());
  Points x = points_of(s.fine);
  for (Vector3d& p : x) p.x() *= 1.2;
  EXPECT_NEAR(two.internal_energy(x), 2 * one.internal_energy(x), 1e-4 * two.internal_energy(x));
  const Points f1 = one.internal_forces(x), f2 = two.internal_forces(x);
  Points xc = points_of(scene.garment);
  for (Vector3d& p : xc) p.x() *= 1.2;
  const Points fc = coarse.internal_forces(xc);
  for (std::size_t v = 0; v < x.size(); ++v) {
    const Vector3d expected = v < fc.size() ? Vector3d(f1[v] + fc[v]) : f1[v];
    EXPECT_LT((f2[v] - expected).norm(), 1e-4);
  }
}

TEST(Dynamics, FreeFallIsExact) {
  // Symplectic: after n steps of h, x = -g h^2 n (n + 1) / 2.
  Scene scene = sheet_scene();
  scene.wind.density = 0;
  Simulation simulation(scene, Mode::kCoarse);
  const Positions start = simulation.next_frame().coarse.positions;
  SimulatedFrame frame;
  for (int k = 1; k <= 10; ++k) frame = simulation.next_frame();
  const double h = 0.005, n = 80;
  const double fall = 9.81 * h * h * n * (n + 1) / 2;
  const Positions moved = frame.coarse.positions - start;
  EXPECT_LT((moved.col(1).array() + static_cast<float>(fall)).abs().maxCoeff(), 2e-6f);
  EXPECT_LT(moved.col(0).cwiseAbs().maxCoeff(), 1e-6f);
}

TEST(Dynamics, HangingStripStretchesAsTheIntegralSays) {
  Scene scene;
  scene.name = "strip";
  scene.garment = sheet(4, 20, 0.1, 0.5);
  scene.material = plain_material(20, 1e-6);
  scene.material.density = 2;  // heavy, for a clear extension
  scene.transform.rotation = {std::numbers::pi / 2, 0, 0};
  scene.damping_s = 0.05;
  scene.wind.density = 0;
  scene.frames = 400;
  scene.frame_time_s = 0.02;
  scene.steps_per_frame = 1;
  scene.threads = 1;
  Handle top;
  for (std::uint32_t i = 0; i < 5; ++i) top.vertices.push_back(i);
  top.hard = true;
  scene.handles.push_back(top);
  Simulation simulation(scene, Mode::kCoarse);
  SimulatedFrame frame;
  while (simulation.next_index() < 400) frame = simulation.next_frame();
  const double length =
      static_cast<double>(frame.coarse.positions.col(1).maxCoeff() - frame.coarse.positions.col(1).minCoeff());
  // Tension per width T(s) = density g s, s from the lower end; T = modulus stretch (stretch^2 - 1) / 2.
  double expected = 0;
  constexpr int kPieces = 2000;
  for (int i = 0; i < kPieces; ++i) {
    const double tension = 2 * 9.81 * 0.5 * (i + 0.5) / kPieces;
    double stretch = 1;
    for (int k = 0; k < 50; ++k) {
      const double f = 20 * stretch * (stretch * stretch - 1) / 2 - tension;
      stretch -= f / (10 * (3 * stretch * stretch - 1));
    }
    expected += stretch * 0.5 / kPieces;
  }
  EXPECT_GT(expected, 0.55);
  EXPECT_NEAR(length, expected, 0.01 * expected);
  EXPECT_LT(frame.coarse.velocities.rowwise().norm().maxCoeff(), 5e-3f);
}

TEST(Dynamics, AirSlowsTheFallToItsTerminalSpeed) {
  // Pressure density v^2 per area carries the weight at v = sqrt(0.2 g / density): 1.4 m/s.
  Scene scene = sheet_scene(4);
  scene.frames = 100;
  Simulation simulation(scene, Mode::kCoarse);
  SimulatedFrame frame;
  while (simulation.next_index() < 60) frame = simulation.next_frame();
  EXPECT_NEAR(frame.coarse.velocities.col(1).mean(), -std::sqrt(0.2 * 9.81), 0.02);
}

}  // namespace
}  // namespace pleat::simulation
