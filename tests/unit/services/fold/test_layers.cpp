#include "services/fold/layers.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

// A strip that is folded over itself: the half with x > 0 comes back `height` above the other one.
Positions folded(const Positions& rest, float height) {
  Positions p = rest;
  for (Eigen::Index v = 0; v < p.rows(); ++v) {
    if (rest(v, 0) <= 0) continue;
    p(v, 0) = -rest(v, 0);
    p(v, 1) = height;
  }
  return p;
}

class LayersTest : public testing::Test {
 protected:
  LayersTest()
      : coarse(simulation::sheet(10, 4, 1.0, 0.4)), subdivision(subdivide(coarse, 2)), finder(coarse, subdivision) {}

  std::vector<Float4> upsampled(const Positions& positions) const {
    const Positions fine = upsample(subdivision, coarse.faces, positions);
    std::vector<Float4> result;
    for (Eigen::Index v = 0; v < fine.rows(); ++v) result.push_back(to_float4(fine.row(v).transpose()));
    return result;
  }

  Topology coarse;
  Subdivision subdivision;
  LayerFinder finder;
};

TEST_F(LayersTest, AFlatSheetHasOneLayer) {
  EXPECT_TRUE(
      finder
          .find(coarse.rest_positions, upsampled(coarse.rest_positions), upsampled(coarse.rest_positions), 0.02f, 3e-3f)
          .empty());
}

TEST_F(LayersTest, FindsThePointOppositeOfAVertexOnTheCoarseCloth) {
  const Positions positions = folded(coarse.rest_positions, 0.01f);
  const auto fine = upsampled(positions);
  const auto contacts = finder.find(positions, fine, fine, 0.02f, 3e-3f);
  ASSERT_GT(contacts.size(), fine.size() / 2);
  for (const LayerContact& c : contacts) {
    Float4 opposite{};
    float sum = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_GE(c.weights[k], -1e-5f);
      opposite += c.weights[k] * fine[c.face[k]];
      sum += c.weights[k];
    }
    EXPECT_NEAR(sum, 1, 1e-5);
    const Float4 d = fine[c.vertex] - opposite, along = c.normal * d;
    EXPECT_LT(std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), 0.02f);
    EXPECT_GT(along[0] + along[1] + along[2], c.gap - 1e-5f);
    EXPECT_LE(c.gap, 3e-3f);
  }
}

// Where the fine cloth has slid along the coarse one, a vertex meets the point that it stands before.
TEST_F(LayersTest, GoesToThePointThatTheFineVertexStandsBefore) {
  const Positions positions = folded(coarse.rest_positions, 0.01f);
  const auto base = upsampled(positions);
  std::vector<Float4> fine = base;
  for (std::size_t v = 0; v < fine.size(); ++v) {
    if (base[v][1] > 0.005f) fine[v] += Float4{0, 0, 0.03f, 0};  // the upper layer slides by one and a half fine edges
  }
  std::size_t met = 0;
  for (const LayerContact& c : finder.find(positions, base, fine, 0.02f, 3e-3f)) {
    Float4 opposite{};
    for (std::size_t k = 0; k < 3; ++k) opposite += c.weights[k] * fine[c.face[k]];
    const Float4 d = fine[c.vertex] - opposite;
    const bool border = std::abs(fine[c.vertex][2]) > 0.15f || std::abs(fine[c.vertex][0]) < 0.15f;
    if (border) continue;
    EXPECT_LT(std::hypot(d[0], d[2]), 1e-4f);
    ++met;
  }
  EXPECT_GT(met, fine.size() / 4);
}

// A stream that begins in the middle, after a kill, has another tree; the answer must be the same to the bit.
TEST_F(LayersTest, WhatIsFoundDoesNotDependOnEarlierFrames) {
  const Positions positions = folded(coarse.rest_positions, 0.01f), other = folded(coarse.rest_positions, 0.3f);
  const auto fine = upsampled(positions);
  const auto first = finder.find(positions, fine, fine, 0.02f, 3e-3f);
  const std::vector<LayerContact> expected(first.begin(), first.end());
  LayerFinder late(coarse, subdivision);
  Positions turned = other;
  turned.col(0).swap(turned.col(2));
  late.find(turned, upsampled(turned), upsampled(turned), 0.02f, 3e-3f);
  const auto again = late.find(positions, fine, fine, 0.02f, 3e-3f);
  ASSERT_EQ(again.size(), expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k) {
    EXPECT_EQ(again[k].vertex, expected[k].vertex);
    EXPECT_EQ(again[k].face, expected[k].face);
    EXPECT_EQ(again[k].weights, expected[k].weights);
  }
}

TEST_F(LayersTest, FarLayersDoNotMeetAndThinOnesKeepTheirOwnGap) {
  const Positions far = folded(coarse.rest_positions, 0.05f);
  for (const LayerContact& c : finder.find(far, upsampled(far), upsampled(far), 0.02f, 3e-3f)) {
    EXPECT_LT(std::abs(upsampled(far)[c.vertex][0]), 0.11f);  // beside the fold, where the layers come together
  }
  const Positions thin = folded(coarse.rest_positions, 1e-3f);
  const auto contacts = finder.find(thin, upsampled(thin), upsampled(thin), 0.02f, 3e-3f);
  ASSERT_FALSE(contacts.empty());
  for (const LayerContact& c : contacts) EXPECT_LT(c.gap, 1.1e-3f);
}

}  // namespace
}  // namespace pleat::fold
