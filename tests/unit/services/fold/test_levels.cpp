#include "services/fold/levels.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "common/mesh/connectivity.hpp"
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

TEST_F(LevelsTest, WithoutHandlesTheyAreSofter) {
  for (std::uint32_t v = 0; v < count; ++v) x[v][0] *= 1.02f;
  const std::vector<Float4> stretched = x;
  const auto most = [&] {
    x = stretched;
    float longest = 0;
    for (const Float4& move : moves()) longest = std::max(longest, length(move));
    return longest;
  };
  const float worn = most();
  fixed[0] = 1;
  EXPECT_LT(worn, 0.7f * most());
  EXPECT_GT(worn, 0);
}

// What one pass finds wrong about a vertex is known to its own faces only; moved alone it would stand out as a lump.
TEST_F(LevelsTest, MovesOfTheCoarsestLevelAreAveraged) {
  const Subdivision once = subdivide(coarse, 1);  // no other level
  CoarserLevels coarsest(coarse, once, simulation::plain_material(60, 2e-5));
  coarsest.set_step(std::vector<char>(static_cast<std::size_t>(once.fine.vertex_count()), 0), kStep);
  const auto size = static_cast<std::uint32_t>(coarse.vertex_count());
  std::uint32_t middle = 0;
  while (coarse.rest_positions.row(middle).norm() > 1e-4f) ++middle;
  std::vector<Float4> sheet(x.begin(), x.begin() + once.fine.vertex_count() + 1);
  sheet[middle][0] += 0.01f;
  std::vector<Float4> moved = sheet;
  coarsest.solve(sheet);
  float most = 0, beyond = 0, step = 0;
  for (std::uint32_t v = 0; v < size; ++v) {
    moved[v] = sheet[v] - moved[v];
    most = std::max(most, length(moved[v]));
    if (std::abs(coarse.rest_positions(v, 0)) > 0.12f) beyond = std::max(beyond, length(moved[v]));
  }
  for (const Edge& edge : build_connectivity(coarse.vertex_count(), coarse.faces).edges) {
    step = std::max(step, length(moved[edge.v0] - moved[edge.v1]));
  }
  EXPECT_LT(step, most) << "neighbours move alike";
  EXPECT_GT(beyond, 0.2f * most) << "two rings farther than one pass reaches";
}

}  // namespace
}  // namespace pleat::fold
