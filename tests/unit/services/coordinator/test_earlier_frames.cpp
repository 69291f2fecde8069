#include "services/coordinator/earlier_frames.hpp"

#include <gtest/gtest.h>

namespace pleat::coordinator {
namespace {

std::vector<std::uint64_t> fill(EarlierFrames& frames, std::uint64_t index) {
  v1::Frame frame;
  frame.set_index(index);
  frame.add_positions(static_cast<float>(index));
  std::vector<std::uint64_t> indices;
  for (const auto& earlier : frames.fill(frame)) indices.push_back(earlier->index());
  return indices;
}

using Indices = std::vector<std::uint64_t>;

TEST(EarlierFrames, TheFirstStandsForThoseBeforeIt) {
  EarlierFrames frames(3);
  EXPECT_EQ(fill(frames, 0), (Indices{0, 0}));
  EXPECT_EQ(fill(frames, 1), (Indices{0, 0}));
  EXPECT_EQ(fill(frames, 2), (Indices{0, 1}));
  EXPECT_EQ(fill(frames, 3), (Indices{1, 2}));
}

TEST(EarlierFrames, AFrameSentAgainGetsTheSame) {
  EarlierFrames frames(3);
  for (std::uint64_t k = 0; k < 5; ++k) fill(frames, k);
  EXPECT_EQ(fill(frames, 4), (Indices{2, 3}));
  EXPECT_EQ(fill(frames, 5), (Indices{3, 4}));
}

TEST(EarlierFrames, AnEarlierIndexStartsAnew) {
  EarlierFrames frames(3);
  for (std::uint64_t k = 5; k < 9; ++k) fill(frames, k);
  EXPECT_EQ(fill(frames, 0), (Indices{0, 0}));
  EXPECT_EQ(fill(frames, 1), (Indices{0, 0}));
  EXPECT_EQ(fill(frames, 2), (Indices{0, 1}));
}

TEST(EarlierFrames, AGapIsNoFrame) {
  EarlierFrames frames(2);
  fill(frames, 0);
  EXPECT_EQ(fill(frames, 4), (Indices{0}));
}

TEST(EarlierFrames, AStrideLeavesFramesOut) {
  EarlierFrames frames(3, 4);
  for (std::uint64_t k = 0; k < 6; ++k) fill(frames, k);
  EXPECT_EQ(fill(frames, 6), (Indices{0, 2}));
  EXPECT_EQ(fill(frames, 7), (Indices{0, 3}));
  for (std::uint64_t k = 8; k < 20; ++k) fill(frames, k);
  EXPECT_EQ(fill(frames, 20), (Indices{12, 16}));
  EXPECT_EQ(fill(frames, 20), (Indices{12, 16}));
  EXPECT_EQ(fill(frames, 21), (Indices{13, 17}));
}

TEST(EarlierFrames, AWindowOfOneRemembersNothing) {
  EarlierFrames frames(1);
  EXPECT_TRUE(fill(frames, 0).empty());
  EarlierFrames unset(0);
  EXPECT_TRUE(fill(unset, 0).empty());
}

}  // namespace
}  // namespace pleat::coordinator
