#include "services/fold/constraints.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <numeric>
#include <set>

#include "common/mesh/connectivity.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

class ConstraintsTest : public testing::Test {
 protected:
  ConstraintsTest() : mesh(simulation::sheet(6, 4, 0.6, 0.4)), count(static_cast<std::uint32_t>(mesh.vertex_count())) {
    for (const float mass : lumped_masses(mesh, 0.2)) inverse_masses.push_back(1 / mass);
    for (std::uint32_t v = 0; v < count; ++v) x.push_back(to_float4(mesh.rest_positions.row(v).transpose()));
    x.push_back(Float4{});
  }

  static float length(Float4 d) { return std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]); }

  Topology mesh;
  std::uint32_t count;
  simulation::Material material = simulation::plain_material(60, 2e-5);
  std::vector<float> inverse_masses;
  std::vector<Float4> x;
};

TEST_F(ConstraintsTest, MassesAreThoseOfTheSheet) {
  const auto masses = lumped_masses(mesh, 0.2);
  EXPECT_NEAR(std::accumulate(masses.begin(), masses.end(), 0.0), 0.2 * 0.6 * 0.4, 1e-6);
}

TEST_F(ConstraintsTest, NothingMovesAtRest) {
  const std::vector<Float4> before = x;
  SpringPacks springs(edge_springs(mesh, material), count);
  HingePacks hinges(edge_hinges(mesh, material), count);
  springs.set_step(inverse_masses, 0.002f);
  hinges.set_step(inverse_masses, 0.002f);
  springs.solve(x, false);
  hinges.solve(x);
  for (std::uint32_t v = 0; v < count; ++v) EXPECT_LT(length(x[v] - before[v]), 1e-6f);
}

TEST_F(ConstraintsTest, AnEdgeHasOneSpringAndAPackNoVertexTwice) {
  const auto springs = edge_springs(mesh, material);
  EXPECT_EQ(springs.size(), build_connectivity(mesh.vertex_count(), mesh.faces).edges.size());
  const auto hinges = edge_hinges(mesh, material);
  std::size_t packed = 0;
  for (const auto& members : independent_packs(std::span<const Hinge>(hinges))) {
    std::set<std::uint32_t> vertices;
    for (const std::uint32_t m : members) vertices.insert(hinges[m].v.begin(), hinges[m].v.end());
    EXPECT_EQ(vertices.size(), 4 * members.size());
    EXPECT_LE(members.size(), kLanes);
    packed += members.size();
  }
  EXPECT_EQ(packed, hinges.size());
}

// XPBD's first iteration: the error shrinks by the share of the compliance, momentum stays.
TEST_F(ConstraintsTest, ASpringMovesItsEndsByTheirMobility) {
  const std::vector<Spring> one{{{0, 1}, 0.1f, 50.0f, 50.0f}};
  const std::vector<float> mobility{2000, 1000};
  std::vector<Float4> y{Float4{}, Float4{0, 0.13f, 0, 0}, Float4{}};
  SpringPacks springs(one, 2);
  springs.set_step(mobility, 0.01f);
  springs.solve(y, false);
  const float lambda = 0.03f / (3000 + 1 / (50 * 1e-4f));
  EXPECT_NEAR(y[0][1], 2000 * lambda, 1e-7);
  EXPECT_NEAR(y[1][1], 0.13f - 1000 * lambda, 1e-7);
  // A compressed one is left alone if only stretched ones are to be solved, and a fixed end does not move.
  y = {Float4{}, Float4{0, 0.05f, 0, 0}, Float4{}};
  springs.solve(y, true);
  EXPECT_EQ(y[1][1], 0.05f);
  springs.set_step(std::vector<float>{0, 1000}, 0.01f);
  springs.solve(y, false);
  EXPECT_EQ(y[0][1], 0);
  EXPECT_GT(y[1][1], 0.05f);
}

// The length of a hinge's sum is the angle between its faces, wherever the hinge is and however it is turned.
TEST_F(ConstraintsTest, AHingesSumIsItsAngle) {
  const double angle = 0.2;
  for (std::uint32_t v = 0; v < count; ++v) {  // folded along the line x = 0 of material coordinates
    const float along = mesh.rest_positions(v, 0);
    if (along > 0) {
      x[v][0] = along * static_cast<float>(std::cos(angle));
      x[v][1] += along * static_cast<float>(std::sin(angle));
    }
  }
  double bent = 0;
  for (const Hinge& hinge : edge_hinges(mesh, material)) {
    Float4 sum{};
    for (std::size_t k = 0; k < 4; ++k) sum += hinge.weights[k] * x[hinge.v[k]];
    bent = std::max(bent, static_cast<double>(length(sum)));
  }
  EXPECT_NEAR(bent, 2 * std::sin(angle / 2), 0.05 * angle);
}

TEST_F(ConstraintsTest, HingesFlattenAndKeepMomentum) {
  HingePacks hinges(edge_hinges(mesh, material), count);
  hinges.set_step(inverse_masses, 1);  // long enough to be hard
  for (std::uint32_t v = 0; v < count; ++v) x[v][1] = 5e-3f * std::cos(40 * x[v][0]) * std::cos(30 * x[v][2]);
  const auto roughness = [&] {
    double sum = 0;
    for (std::uint32_t v = 0; v < count; ++v) sum += static_cast<double>(x[v][1]) * static_cast<double>(x[v][1]);
    return sum;
  };
  const auto momentum = [&] {
    double sum = 0;
    for (std::uint32_t v = 0; v < count; ++v) {
      sum += static_cast<double>(x[v][1]) / static_cast<double>(inverse_masses[v]);
    }
    return sum;
  };
  const double rough = roughness(), before = momentum();
  for (int k = 0; k < 50; ++k) hinges.solve(x);
  EXPECT_LT(roughness(), 0.5 * rough);
  EXPECT_NEAR(momentum(), before, 1e-7);
}

}  // namespace
}  // namespace pleat::fold
