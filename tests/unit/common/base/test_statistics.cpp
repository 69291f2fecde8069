#include "common/base/statistics.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace pleat {
namespace {

TEST(Quantile, InterpolatesBetweenOrderStatistics) {
  EXPECT_DOUBLE_EQ(median({3, 1, 2}), 2);
  EXPECT_DOUBLE_EQ(median({4, 1, 2, 3}), 2.5);
  EXPECT_DOUBLE_EQ(quantile({0, 10}, 0.95), 9.5);
  EXPECT_DOUBLE_EQ(quantile({7}, 0.95), 7);
  EXPECT_DOUBLE_EQ(median({}), 0);
}

TEST(Psnr, IsTenTimesTheLogarithmOfPeakSquaredOverError) {
  EXPECT_DOUBLE_EQ(psnr_db(0.01), 20);
  EXPECT_DOUBLE_EQ(psnr_db(0.01, 10), 40);
  EXPECT_TRUE(std::isinf(psnr_db(0)));
}

}  // namespace
}  // namespace pleat
