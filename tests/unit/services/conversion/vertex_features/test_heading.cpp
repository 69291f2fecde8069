#include "services/conversion/vertex_features/heading.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/unit/services/conversion/vertex_features/sheets.hpp"

namespace pleat::conversion {
namespace {

TEST(Heading, FollowsTheTurnOfMovedAndWavyCloth) {
  const Topology t = test::sheet(9, 9, 0.125f);
  const Positions wavy = test::deform(t, test::waves);
  const float still = heading(t.rest_positions, wavy, 0);
  EXPECT_NEAR(still, 0, 0.05f);
  float angle = 0;
  for (int k = 0; k <= 60; ++k) {
    const float expected = 0.2f * static_cast<float>(k);
    const Eigen::Matrix3f turn = Eigen::AngleAxisf(expected, Eigen::Vector3f::UnitY()).matrix();
    angle = heading(t.rest_positions, (wavy * turn.transpose()).rowwise() + Eigen::RowVector3f(3, 1, -7), angle);
    EXPECT_NEAR(angle, expected + still, 1e-4f);  // through two turns, without a jump
  }
}

TEST(Heading, KeepsTheLastOneWhereThereIsNone) {
  const Topology t = test::sheet(9, 9, 0.125f);
  Positions upright(t.rest_positions);
  upright.col(1) = t.rest_positions.col(0);
  upright.col(0).setZero();
  upright.col(2).setZero();
  EXPECT_EQ(heading(t.rest_positions, upright, 1.25f), 1.25f);
  EXPECT_EQ(heading(upright, upright, -2.0f), -2.0f);
}

TEST(Heading, Centroid) {
  const Positions p = test::sheet(3, 5, 0.1f).rest_positions;
  EXPECT_LT((centroid(p) - Eigen::Vector3f(0.1f, 0, 0.2f)).norm(), 1e-6f);
  EXPECT_EQ(centroid(Positions(0, 3)), Eigen::Vector3f::Zero());
}

}  // namespace
}  // namespace pleat::conversion
