#include "services/fold/tracking.hpp"

#include <gtest/gtest.h>

#include <numeric>
#include <vector>

#include "services/fold/constraints.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

constexpr float kStep = 1.0f / 300, kGravity = 9.81f;

class HoldTest : public testing::Test {
 protected:
  HoldTest()
      : coarse(simulation::sheet(6, 6, 0.6, 0.6)),
        subdivision(subdivide(coarse, 2)),
        tracking(coarse, subdivision, lumped_masses(subdivision.fine, 0.2)) {}

  // A cloth of loose vertices that weight draws along `weight` for three seconds; how far it goes on average.
  Float4 sag(Float4 weight, std::span<const float> touching) {
    tracking.set_touching(touching);
    const auto count = static_cast<std::size_t>(subdivision.fine.vertex_count());
    std::vector<Float4> x(count, Float4{}), v(count, Float4{}), before;
    const Float4 down{0, -1, 0, 0};
    for (int k = 0; k < 900; ++k) {
      before = x;
      for (std::size_t i = 0; i < count; ++i) x[i] += kStep * (v[i] + kStep * kGravity * weight);
      tracking.hold(
          [&](std::uint32_t i) {
            return Tracking::Lack{-x[i], (before[i] - x[i]) / kStep, {}};
          },
          kStep, down, x);
      for (std::size_t i = 0; i < count; ++i) v[i] = (x[i] - before[i]) / kStep;
    }
    return std::accumulate(x.begin(), x.end(), Float4{}) / static_cast<float>(count);
  }

  Topology coarse;
  Subdivision subdivision;
  Tracking tracking;
};

// A spring gives way by weight over its square frequency.
TEST_F(HoldTest, HoldsHarderAlongTheWeightThanAcross) {
  const std::vector<float> all(static_cast<std::size_t>(coarse.vertex_count()), 1);
  EXPECT_NEAR(sag(Float4{0, -1, 0, 0}, all)[1], -kGravity / (200 * 200), 1e-5);
  EXPECT_NEAR(sag(Float4{1, 0, 0, 0}, all)[0], kGravity / (40 * 40), 1e-4);
}

TEST_F(HoldTest, WhatDoesNotTouchFalls) {
  const std::vector<float> none(static_cast<std::size_t>(coarse.vertex_count()), 0);
  EXPECT_LT(sag(Float4{0, -1, 0, 0}, none)[1], -40);
}

}  // namespace
}  // namespace pleat::fold
