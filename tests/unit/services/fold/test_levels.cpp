#include "services/fold/levels.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

class LevelsTest : public testing::Test {
 protected:
  static constexpr float kStep = 0.0033f;
  LevelsTest()
      : coarse(simulation::sheet(8, 8, 0.4, 0.4)),
        subdivision(subdivide(coarse, 2)),
        count(static_cast<std::uint32_t>(subdivision.fine.vertex_count())),
        fixed(count, 0),
        levels(coarse, subdivision, simulation::plain_material(60, 2e-5)) {
    for (std::uint32_t v = 0; v < count; ++v) {
      x.push_back(to_float4(subdivision.fine.rest_positions.row(v).transpose()));
    }
    x.push_back(Float4{});
  }
  std::vector<Float4> moves() {
    std::vector<Float4> before = x;
    levels.set_step(fixed, kStep);
    levels.solve(x);
    for (std::uint32_t v = 0; v < count; ++v) before[v] = x[v] - before[v];
    return before;
  }
  static float length(Float4 d) { return std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]); }

  Topology coarse;
  Subdivision subdivision;
  std::uint32_t count;
  std::vector<char> fixed;
  CoarserLevels levels;
  std::vector<Float4> x;
};

TEST_F(LevelsTest, WhatIsNotStretchedStays) {
  for (std::uint32_t v = 0; v < count; ++v) x[v][0] *= 0.9f;
  for (std::uint32_t v = 0; v < count; ++v) EXPECT_LT(length(moves()[v]), 1e-5f) << v;
}

TEST_F(LevelsTest, FixedVerticesStayAndPullTheOthers) {
  const auto left = [&](std::uint32_t v) { return subdivision.fine.rest_positions(v, 0) < -0.199f; };
  for (std::uint32_t v = 0; v < count; ++v) {
    fixed[v] = left(v) ? 1 : 0;
    if (!left(v)) x[v][0] += 0.02f;  // the first column of faces is stretched
  }
  const std::vector<Float4> moved = moves();
  float back = 0;
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(coarse.vertex_count()); ++v) {
    if (fixed[v]) {
      EXPECT_EQ(length(moved[v]), 0) << v;
    }
    back = std::min(back, moved[v][0]);
  }
  EXPECT_LT(back, -1e-3f);
}

}  // namespace
}  // namespace pleat::fold
