#include "services/coordinator/session_memory.hpp"

#include <gtest/gtest.h>

#include "tests/support/errors.hpp"

namespace pleat::coordinator {
namespace {

PipelineSession session_of(v1::Detail detail, std::uint32_t window = 1) {
  PipelineSession session;
  session.detail = detail;
  session.coarse.set_hash("mesh");
  session.representation.set_window(window);
  session.model.set_model("bundle");
  return session;
}

v1::Frame coarse(std::uint64_t index) {
  v1::Frame frame;
  frame.set_index(100 + index);
  return frame;
}

PipelineFrame answered(std::uint64_t sequence, bool fold = false) {
  PipelineFrame frame;
  frame.sequence = sequence;
  if (fold) {
    auto memory = std::make_shared<FoldMemory>();
    memory->state.add_positions(static_cast<float>(sequence));
    frame.fold_memory = std::move(memory);
  }
  return frame;
}

TEST(SessionMemory, ACheckpointHasTheFramesOfTheWindow) {
  const PipelineSession session = session_of(v1::DETAIL_NETWORK, 3);
  SessionMemory memory(session, 5);
  // Two frames are ahead of their answers.
  for (std::uint64_t i = 0; i < 2; ++i) memory.remember(i, coarse(i));
  std::string text;
  for (std::uint64_t i = 0; i < 10; ++i) {
    memory.remember(i + 2, coarse(i + 2));
    text = memory.checkpoint(answered(i));
    EXPECT_EQ(text.empty(), i % 5 != 4) << i;
  }
  const v1::SessionCheckpoint checkpoint = parse_checkpoint(text, session);
  EXPECT_EQ(checkpoint.frames(), 10U);
  ASSERT_EQ(checkpoint.earlier_size(), 2);
  EXPECT_EQ(checkpoint.earlier(0).index(), 108U);
  EXPECT_EQ(checkpoint.earlier(1).index(), 109U);
  EXPECT_FALSE(checkpoint.has_fold());
}

TEST(SessionMemory, AWindowWithAStrideReachesFurtherBack) {
  PipelineSession session = session_of(v1::DETAIL_NETWORK, 3);
  session.representation.set_window_stride(2);
  SessionMemory memory(session, 6);
  std::string text;
  for (std::uint64_t i = 0; i < 6; ++i) {
    memory.remember(i, coarse(i));
    text = memory.checkpoint(answered(i));
  }
  const v1::SessionCheckpoint checkpoint = parse_checkpoint(text, session);
  ASSERT_EQ(checkpoint.earlier_size(), 4) << "the next frame reads those two and four before it";
  EXPECT_EQ(checkpoint.earlier(0).index(), 102U);
}

TEST(SessionMemory, BehindAFrameThatFailedThereIsNone) {
  SessionMemory memory(session_of(v1::DETAIL_FOLD), 2);
  memory.remember(0, coarse(0));
  EXPECT_TRUE(memory.checkpoint(answered(0, true)).empty()) << "not due";
  PipelineFrame failed = answered(1);
  failed.fail(3, "bad");
  EXPECT_TRUE(memory.checkpoint(failed).empty());
  memory.remember(2, coarse(2));
  const v1::SessionCheckpoint checkpoint =
      parse_checkpoint(memory.checkpoint(answered(2, true)), session_of(v1::DETAIL_FOLD));
  EXPECT_EQ(checkpoint.frames(), 3U);
  ASSERT_EQ(checkpoint.earlier_size(), 1) << "differences need one, and it is one that was right";
  EXPECT_EQ(checkpoint.earlier(0).index(), 102U);
  EXPECT_EQ(checkpoint.fold().positions(0), 2.0F);
}

TEST(SessionMemory, ANetworkThatRemembersGoesOn) {
  PipelineSession session = session_of(v1::DETAIL_NETWORK);
  session.model.set_state_values(1);
  SessionMemory memory(session, 1);
  memory.remember(0, coarse(0));
  EXPECT_TRUE(memory.checkpoint(answered(0)).empty()) << "it left nothing";
  memory.remember(1, coarse(1));
  PipelineFrame frame = answered(1);
  auto left = std::make_shared<NetworkMemory>();
  left->state = "four";
  frame.network_memory = left;
  EXPECT_EQ(parse_checkpoint(memory.checkpoint(frame), session).network_state(), "four");
}

TEST(SessionMemory, NobodyAskedNothingKept) {
  SessionMemory memory(session_of(v1::DETAIL_NETWORK), 0);
  for (std::uint64_t i = 0; i < 100; ++i) {
    memory.remember(i, coarse(i));
    EXPECT_TRUE(memory.checkpoint(answered(i)).empty());
  }
}

TEST(SessionMemory, WhatIsNoCheckpointOfThisSessionIsRefused) {
  PipelineSession session = session_of(v1::DETAIL_NETWORK);
  SessionMemory memory(session, 1);
  memory.remember(0, coarse(0));
  const std::string text = memory.checkpoint(answered(0));
  EXPECT_NO_THROW(parse_checkpoint(text, session));
  const auto code = [&](const std::string& bytes) {
    return test::error_of([&] { parse_checkpoint(bytes, session); }).code();
  };
  EXPECT_EQ(code("\x0f"), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code(""), ErrorCode::kInvalidArgument);
  v1::SessionCheckpoint far = parse_checkpoint(text, session);
  far.set_frames(~std::uint64_t{0});
  EXPECT_EQ(code(far.SerializeAsString()), ErrorCode::kInvalidArgument);
  session.coarse.set_hash("another");
  EXPECT_EQ(code(text), ErrorCode::kInvalidArgument);
  session.coarse.set_hash("mesh");
  session.model.mutable_representation()->set_window(2);
  EXPECT_EQ(code(text), ErrorCode::kFailedPrecondition) << "another bundle by now";
}

}  // namespace
}  // namespace pleat::coordinator
