#include "services/conversion/normalization.hpp"

#include <gtest/gtest.h>

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

TEST(Normalization, RoundTrip) {
  const Tensor original = random_tensor(1);
  Normalization n;
  extend_normalization(n, original);
  Tensor tensor = original;
  EXPECT_EQ(normalize(tensor, n), 0u);
  for (const float value : tensor.values) {
    EXPECT_GE(value, 0);
    EXPECT_LE(value, 1);
  }
  denormalize(tensor, n);
  for (std::size_t i = 0; i < tensor.values.size(); ++i) EXPECT_NEAR(tensor.values[i], original.values[i], 2e-6);
}

TEST(Normalization, ValuesOutsideAreCountedAndKept) {
  Tensor tensor{{1, 4}, {"a"}, {-1, 0, 1, 3}};
  EXPECT_EQ(normalize(tensor, {{0}, {2}}), 2u);
  EXPECT_EQ(tensor.values, (std::vector<float>{-0.5f, 0, 0.5f, 1.5f}));
}

TEST(Normalization, AConstantChannelSurvives) {
  Tensor tensor{{1, 3}, {"a"}, {7, 7, 7}};
  Normalization n;
  extend_normalization(n, tensor);
  EXPECT_EQ(normalize(tensor, n), 0u);
  EXPECT_EQ(tensor.values[0], 0.5f);
  denormalize(tensor, n);
  EXPECT_EQ(tensor.values[0], 7);
}

TEST(Normalization, OnlyMaskedTexelsCount) {
  const Tensor tensor{{1, 2, 2}, {"a"}, {1, 100, 2, -100}};
  const std::vector<std::uint8_t> mask{1, 0, 1, 0};
  Normalization n;
  extend_normalization(n, tensor, mask);
  EXPECT_EQ(n.minimum[0], 1);
  EXPECT_EQ(n.maximum[0], 2);
}

TEST(Normalization, BadInputIsRefused) {
  Tensor tensor = random_tensor(2);
  EXPECT_THROW(normalize(tensor, {{0}, {1}}), Error);
  EXPECT_THROW(normalize(tensor, {{0, 1}, {1, 0}}), Error);
  Tensor empty;
  EXPECT_THROW(normalize(empty, {}), Error);
}

}  // namespace
}  // namespace pleat
