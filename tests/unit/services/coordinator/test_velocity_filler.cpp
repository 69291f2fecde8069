#include <gtest/gtest.h>

#include <array>

#include "services/coordinator/velocity_filler.hpp"

namespace pleat::coordinator {
namespace {

std::vector<float> fill(VelocityFiller& filler, std::uint64_t index, std::array<float, 3> positions) {
  return filler.fill(index, positions.data(), positions.size());
}

TEST(VelocityFiller, BackwardDifferences) {
  VelocityFiller filler(0.5);
  EXPECT_EQ(fill(filler, 0, {1, 2, 3}), (std::vector<float>{0, 0, 0}));
  EXPECT_EQ(fill(filler, 1, {2, 2, 1}), (std::vector<float>{2, 0, -4}));
  EXPECT_EQ(fill(filler, 2, {2, 3, 1}), (std::vector<float>{0, 2, 0}));
}

TEST(VelocityFiller, AFrameSentAgainGetsTheSame) {
  VelocityFiller filler(1);
  fill(filler, 4, {0, 0, 0});
  const auto once = fill(filler, 5, {1, 2, 3});
  EXPECT_EQ(fill(filler, 5, {1, 2, 3}), once);
  EXPECT_EQ(fill(filler, 6, {2, 4, 6}), (std::vector<float>{1, 2, 3}));
}

TEST(VelocityFiller, AGapCountsWithItsTime) {
  VelocityFiller filler(1);
  fill(filler, 0, {0, 0, 0});
  EXPECT_EQ(fill(filler, 4, {4, 8, 0}), (std::vector<float>{1, 2, 0}));
}

TEST(VelocityFiller, AnEarlierIndexStartsAnew) {
  VelocityFiller filler(1);
  fill(filler, 7, {9, 9, 9});
  EXPECT_EQ(fill(filler, 0, {1, 1, 1}), (std::vector<float>{0, 0, 0}));
  EXPECT_EQ(fill(filler, 1, {2, 3, 4}), (std::vector<float>{1, 2, 3}));
}

}  // namespace
}  // namespace pleat::coordinator
