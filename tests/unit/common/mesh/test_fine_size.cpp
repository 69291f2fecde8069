#include "common/mesh/fine_size.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "tests/support/errors.hpp"

namespace pleat {
namespace {

TEST(FineSize, CountsFourTimesAsManyARound) {
  EXPECT_NO_THROW(check_fine_size(1000, 2, 16'000, "open.coarse"));
  const auto error = test::error_of([] { check_fine_size(1001, 2, 16'000, "open.coarse"); });
  EXPECT_EQ(error.code(), ErrorCode::kResourceExhausted);
  EXPECT_STREQ(error.what(), "open.coarse: about 16016 fine vertices, more than this service's limit of 16000");
}

TEST(FineSize, NumbersThatLieDoNotOverflow) {
  const auto huge = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(test::error_of([&] { check_fine_size(huge, 1'000'000, 10, "mesh"); }).code(),
            ErrorCode::kResourceExhausted);
  EXPECT_NO_THROW(check_fine_size(0, 5, 10, "mesh"));
}

}  // namespace
}  // namespace pleat
