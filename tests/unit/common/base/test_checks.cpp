#include "common/base/checks.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "tests/support/errors.hpp"

namespace pleat {
namespace {

TEST(Checks, NameTheFieldAndTheFirstCulprit) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  EXPECT_NO_THROW(check_finite(std::vector<float>{0, -1, std::numeric_limits<float>::max()}, "a"));
  for (const float bad : {nan, infinity, -infinity}) {
    const std::vector<float> values{0, bad, nan};
    EXPECT_STREQ(test::error_of([&] { check_finite(values, "open.coarse"); }).what(),
                 "open.coarse: value 1 is not finite");
  }
  EXPECT_NO_THROW(check_rows(9, 3, "a"));
  EXPECT_STREQ(test::error_of([&] { check_rows(10, 3, "a"); }).what(), "a: 10 values, not a multiple of 3");
  EXPECT_NO_THROW(check_limit(10, 10, "a"));
  EXPECT_STREQ(test::error_of([&] { check_limit(11, 10, "a"); }).what(), "a: 11 values, at most 10");
  const std::vector<std::uint32_t> indices{0, 2, 1, 7};
  EXPECT_NO_THROW(check_indices(indices, 8, "faces"));
  EXPECT_STREQ(test::error_of([&] { check_indices(indices, 2, "faces"); }).what(),
               "faces: index 2 at 1, but there are 2");
}

TEST(Checks, OneValueThatIsNotFiniteIsFoundAnywhere) {
  std::vector<float> values(67, -std::numeric_limits<float>::max());
  values[3] = std::numeric_limits<float>::denorm_min();
  ASSERT_TRUE(all_finite(values));
  for (std::size_t i = 0; i < values.size(); ++i) {
    for (const float bad : {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
      std::vector<float> spoilt = values;
      spoilt[i] = bad;
      EXPECT_FALSE(all_finite(spoilt)) << i;
    }
  }
  EXPECT_TRUE(all_finite(std::vector<float>{}));
}

}  // namespace
}  // namespace pleat
