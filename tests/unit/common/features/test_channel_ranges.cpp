#include "common/features/channel_ranges.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "common/base/error.hpp"

namespace pleat {
namespace {

Tensor random_tensor(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(-3, 5);
  Tensor tensor{{2, 4, 5}, {"a", "b"}, std::vector<float>(40)};
  for (float& value : tensor.values) value = uniform(random);
  return tensor;
}

ChannelRanges extremes_of(const Tensor& tensor) {
  RangeMeasure measure(static_cast<std::size_t>(tensor.shape[0]));
  measure.add(tensor);
  return measure.extremes();
}

TEST(ChannelRanges, ExtremesMakeZeroToOneAndComeBack) {
  const Tensor original = random_tensor(1);
  const ChannelRanges ranges = extremes_of(original);
  Tensor tensor = original;
  EXPECT_EQ(normalize(ranges, tensor), 0u);
  for (const float value : tensor.values) {
    EXPECT_GE(value, 0);
    EXPECT_LE(value, 1);
  }
  denormalize(ranges, tensor);
  for (std::size_t i = 0; i < tensor.values.size(); ++i) EXPECT_NEAR(tensor.values[i], original.values[i], 2e-6);
}

TEST(ChannelRanges, MomentsMakeMeanZeroAndDeviationOne) {
  Tensor tensor = random_tensor(2);
  RangeMeasure measure(2);
  measure.add(tensor);
  normalize(measure.moments(), tensor);
  for (std::size_t c = 0; c < 2; ++c) {
    double sum = 0, squares = 0;
    for (std::size_t i = 20 * c; i < 20 * (c + 1); ++i) {
      sum += static_cast<double>(tensor.values[i]);
      squares += std::pow(static_cast<double>(tensor.values[i]), 2);
    }
    EXPECT_NEAR(sum / 20, 0, 1e-6);
    EXPECT_NEAR(squares / 20, 1, 1e-5);
  }
}

TEST(ChannelRanges, ValuesOutsideAreCountedAndKept) {
  Tensor tensor{{1, 4}, {"a"}, {-1, 0, 1, 3}};
  EXPECT_EQ(normalize({{0}, {2}}, tensor), 2u);
  EXPECT_EQ(tensor.values, (std::vector<float>{-0.5f, 0, 0.5f, 1.5f}));
}

TEST(ChannelRanges, ALimitCutsAndCounts) {
  Tensor tensor{{1, 4}, {"a"}, {-15, 0, 10, 14}};
  EXPECT_EQ(normalize({{0}, {2}, 6}, tensor), 2u);
  EXPECT_EQ(tensor.values, (std::vector<float>{-6, 0, 5, 6}));
}

TEST(ChannelRanges, AnEmptyRangeIsZeroAndComesBackAsItsOffset) {
  Tensor tensor{{2, 2}, {"a", "b"}, {7, 7, 1, 2}};
  ChannelRanges ranges = extremes_of(tensor);
  EXPECT_EQ(ranges.scale[0], 0);
  tensor.values[1] = 9;  // not seen before
  EXPECT_EQ(normalize(ranges, tensor), 0u);
  EXPECT_EQ(tensor.values, (std::vector<float>{0, 0, 0, 1}));
  denormalize(ranges, tensor);
  EXPECT_EQ(tensor.values, (std::vector<float>{7, 7, 1, 2}));
}

TEST(ChannelRanges, WithoutChannelsNothingChanges) {
  const Tensor original = random_tensor(3);
  Tensor tensor = original;
  EXPECT_EQ(normalize({}, tensor), 0u);
  denormalize({}, tensor);
  EXPECT_EQ(tensor.values, original.values);
}

TEST(ChannelRanges, BadOnesAreRefused) {
  Tensor tensor = random_tensor(4);
  EXPECT_THROW(normalize({{0}, {1}}, tensor), Error);
  EXPECT_THROW(denormalize({{0, 1, 2}, {1, 1, 1}}, tensor), Error);
  const auto refused = [](ChannelRanges ranges) { EXPECT_THROW(check_ranges(ranges, 2, "r"), Error); };
  refused({{0}, {1}});
  refused({{0, 0}, {1, -1}});
  refused({{0, 0}, {1}});
  refused({{0, NAN}, {1, 1}});
  refused({{0, 0}, {1, INFINITY}});
  refused({{0, 0}, {1, 1}, -1});
  EXPECT_NO_THROW(check_ranges({{0, 0}, {1, 0}, 6}, 2, "r"));
  EXPECT_NO_THROW(check_ranges({}, 2, "r"));
}

TEST(RangeMeasure, OnlyMaskedPlacesCount) {
  const Tensor tensor{{1, 2, 2}, {"a"}, {1, 100, 2, -100}};
  const std::vector<std::uint8_t> mask{1, 0, 1, 0};
  RangeMeasure measure(1);
  measure.add(tensor, mask);
  EXPECT_EQ(measure.count(), 2u);
  EXPECT_EQ(measure.extremes().offset[0], 1);
  EXPECT_EQ(measure.extremes().scale[0], 1);
  EXPECT_EQ(measure.moments().offset[0], 1.5f);
  EXPECT_EQ(measure.moments().scale[0], 0.5f);
}

TEST(RangeMeasure, PartsGiveTheWhole) {
  RangeMeasure whole(2), first(2), second(2);
  for (const unsigned seed : {5u, 6u}) {
    whole.add(random_tensor(seed));
    (seed == 5 ? first : second).add(random_tensor(seed));
  }
  first.merge(second);
  EXPECT_EQ(first.extremes(), whole.extremes());
  EXPECT_EQ(first.moments(), whole.moments());
}

TEST(RangeMeasure, AMarginWidensBothSides) {
  RangeMeasure measure(1);
  measure.add(Tensor{{1, 2}, {"a"}, {2, 4}});
  const ChannelRanges ranges = measure.extremes(0.25);
  EXPECT_EQ(ranges.offset[0], 1.5f);
  EXPECT_EQ(ranges.scale[0], 3);
}

TEST(RangeMeasure, NothingHasNoRange) {
  EXPECT_THROW(RangeMeasure(3).extremes(), Error);
  EXPECT_THROW(RangeMeasure(3).moments(), Error);
  EXPECT_THROW(RangeMeasure(3).add(random_tensor(1)), Error);
}

}  // namespace
}  // namespace pleat
