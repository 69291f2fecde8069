#include "services/conversion/vertex_features/stream_state.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>

#include "common/base/error.hpp"

namespace pleat::conversion {
namespace {

StreamState example(RotationCode code) {
  StreamState state{-12.5f, {}};
  for (int k = 0; k < 5; ++k) {
    const auto x = static_cast<float>(k);
    state.labels.push_back(Float4{x, -2 * x, 0.5f, code == RotationCode::kQuaternion ? 0.25f : 0});
  }
  return state;
}

TEST(StreamState, BytesRoundTrip) {
  for (const RotationCode code : {RotationCode::kLogarithm, RotationCode::kQuaternion}) {
    const StreamState state = example(code);
    const StreamState back = stream_state_from_bytes(to_bytes(state, code), code, 5);
    EXPECT_EQ(back.heading, state.heading);
    ASSERT_EQ(back.labels.size(), 5u);
    EXPECT_EQ(std::memcmp(back.labels.data(), state.labels.data(), 5 * sizeof(Float4)), 0);
  }
  EXPECT_TRUE(stream_state_from_bytes("", RotationCode::kLogarithm, 5).labels.empty());
}

TEST(StreamState, RefusesWhatIsNotItsOwn) {
  const RotationCode code = RotationCode::kLogarithm;
  const std::string bytes = to_bytes(example(code), code);
  EXPECT_THROW(stream_state_from_bytes(bytes, code, 6), Error);
  EXPECT_THROW(stream_state_from_bytes(bytes, RotationCode::kQuaternion, 5), Error);
  EXPECT_THROW(stream_state_from_bytes(bytes.substr(0, 20), code, 5), Error);
  EXPECT_THROW(stream_state_from_bytes("x", code, 5), Error);
  std::string damaged = bytes;
  damaged[0] = 'X';
  EXPECT_THROW(stream_state_from_bytes(damaged, code, 5), Error);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const std::size_t place : {std::size_t{12}, bytes.size() - sizeof(float)}) {
    damaged = bytes;
    std::memcpy(damaged.data() + place, &nan, sizeof(nan));
    EXPECT_THROW(stream_state_from_bytes(damaged, code, 5), Error);
  }
}

}  // namespace
}  // namespace pleat::conversion
