#include "services/fold/viscosity.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

class ViscosityTest : public testing::Test {
 protected:
  ViscosityTest() : mesh(simulation::sheet(24, 24, 1.2, 1.2)), viscosity(mesh) {}

  std::uint32_t count() const { return static_cast<std::uint32_t>(mesh.vertex_count()); }
  bool at_corner(std::uint32_t v) const {
    return std::abs(mesh.rest_positions(v, 0)) > 0.59f && std::abs(mesh.rest_positions(v, 2)) > 0.59f;
  }
  void run(std::vector<Float4>& velocities, int steps, float step_s) const {
    for (int k = 0; k < steps; ++k) {
      const std::vector<Float4> before = velocities;
      for (std::uint32_t v = 0; v < count(); ++v) velocities[v] += viscosity.share(step_s) * viscosity.lack(v, before);
    }
  }

  Topology mesh;
  Viscosity viscosity;
};

TEST_F(ViscosityTest, CommonMotionsAndTurnsStay) {
  std::vector<Float4> velocities;
  for (std::uint32_t v = 0; v < count(); ++v) {
    const auto p = mesh.rest_positions.row(v);
    velocities.push_back(Float4{2 + 3 * p[2], 1 + 4 * p[0] - p[2], -3 * p[0], 0});
  }
  for (std::uint32_t v = 0; v < count(); ++v) {
    if (at_corner(v)) continue;  // a corner has its neighbours on one side
    const Float4 lack = viscosity.lack(v, velocities);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(lack[k], 0, 1e-5f) << v;
  }
}

// Waves of frequency omega die out as implicit steps h let them, by omega^2 h / 2: in cloth that hangs by 1 m, in the
// middle, waves of 0.4 m with h = 5 ms.
TEST_F(ViscosityTest, WavesDieOutAsTheSimulationsDo) {
  const double wave_number = 2 * std::numbers::pi / 0.4, gravity = 9.81, length = 1, implicit_step = 5e-3;
  const double rate = gravity * length / 2 * wave_number * wave_number * implicit_step / 2;
  std::vector<Float4> velocities;
  for (std::uint32_t v = 0; v < count(); ++v) {
    velocities.push_back(Float4{0, static_cast<float>(std::cos(wave_number * mesh.rest_positions(v, 0))), 0, 0});
  }
  const std::vector<Float4> before = velocities;
  constexpr int kSteps = 24;
  constexpr float kStep = 1.0f / 300;
  run(velocities, kSteps, kStep);
  for (std::uint32_t v = 0; v < count(); ++v) {
    const auto p = mesh.rest_positions.row(v);
    if (std::abs(p[0]) > 0.08f || std::abs(p[2]) > 0.1f) continue;  // borders do not reach so far
    EXPECT_NEAR(velocities[v][1] / before[v][1], std::exp(-rate * kSteps * static_cast<double>(kStep)), 0.03) << v;
  }
}

TEST_F(ViscosityTest, LongStepsDoNotOvershoot) {
  std::vector<Float4> velocities(count(), Float4{});
  velocities[count() / 2][1] = 1;
  float before = 1;
  for (int k = 0; k < 20; ++k) {
    run(velocities, 1, 10);
    float most = 0;
    for (const Float4& velocity : velocities) most = std::max(most, std::abs(velocity[1]));
    EXPECT_LT(most, before);
    before = most;
  }
}

}  // namespace
}  // namespace pleat::fold
