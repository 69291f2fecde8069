#include "services/dataset/materials.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace pleat::dataset {
namespace {

TEST(Materials, LieBetweenThoseThatAreGiven) {
  simulation::Material soft, stiff;
  soft.density = 0.05, stiff.density = 0.2;
  soft.stretching[2][1] = 10, stiff.stretching[2][1] = 1000;
  soft.stretching[0][0] = 100, stiff.stretching[0][0] = 100;
  soft.stretching[3][1] = -4, stiff.stretching[3][1] = 8;  // measured figures may be negative
  soft.bending[1][4] = 1e-6, stiff.bending[1][4] = 1e-4;
  const simulation::Material half = between(soft, stiff, 0.5);
  EXPECT_NEAR(half.density, 0.1, 1e-12);
  EXPECT_NEAR(half.stretching[2][1], 100, 1e-9);
  EXPECT_NEAR(half.stretching[0][0], 100, 1e-9);
  EXPECT_NEAR(half.stretching[3][1], 2, 1e-12);
  EXPECT_NEAR(half.bending[1][4], 1e-5, 1e-15);
  const simulation::Material same = between(soft, stiff, 0), other = between(soft, stiff, 1);
  EXPECT_EQ(same.density, soft.density);
  EXPECT_NEAR(other.bending[1][4], 1e-4, 1e-15);
}

TEST(Materials, TextIsReadBackExactly) {
  simulation::Material material;
  material.density = 0.1 + 1e-17 * 3;
  for (auto& row : material.stretching) row = {1.0 / 3, 2.0 / 7, 1e3 / 11, 0.1};
  for (auto& row : material.bending) row = {1e-6 / 3, 1e-6, 2e-6, 3e-6, 4e-6};
  const simulation::Material read = simulation::parse_material(to_json(material), "text");
  EXPECT_EQ(read.density, material.density);
  EXPECT_EQ(read.stretching, material.stretching);
  EXPECT_EQ(read.bending, material.bending);
}

}  // namespace
}  // namespace pleat::dataset
