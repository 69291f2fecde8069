#include "common/base/random.hpp"

#include <gtest/gtest.h>

namespace pleat {
namespace {

TEST(Random, SplitMixIsThePublishedSequence) {
  std::uint64_t state = 1234567;
  for (const std::uint64_t expected : {6457827717110365317ull, 3203168211198807973ull, 9817491932198370423ull,
                                       4593380528125082431ull, 16408922859458223821ull}) {
    EXPECT_EQ(split_mix(state), expected);
  }
}

TEST(Random, TheUnitIntervalIsHalfOpen) {
  EXPECT_EQ(unit_interval(0), 0);
  EXPECT_LT(unit_interval(~0ull), 1);
  EXPECT_EQ(unit_interval(1ull << 63), 0.5);
}

}  // namespace
}  // namespace pleat
