#include "common/client/cpp/session_stream.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <sstream>
#include <thread>
#include <vector>

#include "common/rpc/channel.hpp"
#include "pleat/v1/coordinator.grpc.pb.h"
#include "tests/support/errors.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::client {
namespace {

using namespace std::chrono_literals;

/// Answers a frame with the sum of the times of all frames of the session so far: what it remembers is in a checkpoint.
class SummingCoordinator final : public v1::Coordinator::Service {
 public:
  grpc::Status Enhance(grpc::ServerContext*,
                       grpc::ServerReaderWriter<v1::EnhanceResponse, v1::EnhanceRequest>* stream) override {
    v1::EnhanceRequest request;
    if (!stream->Read(&request)) return grpc::Status::OK;
    const v1::EnhanceOpen open = request.open();
    if (refuses > 0) {
      --refuses;
      return refusal;
    }
    ++opens;
    std::uint64_t frames = 0;
    double sum = 0;
    std::istringstream(open.checkpoint()) >> frames >> sum;
    resumed_at = frames;
    v1::EnhanceResponse response;
    response.mutable_opened()->set_window(open.window());
    response.mutable_opened()->set_model("bundle");
    response.mutable_opened()->mutable_fine()->set_hash(fine_hash);
    stream->Write(response);
    while (stream->Read(&request)) {
      if (breaks_after > 0 && --breaks_after == 0) return {grpc::StatusCode::UNAVAILABLE, "stopping"};
      ++frames;
      sum += request.frame().coarse().time_s();
      response.Clear();
      response.mutable_frame()->mutable_fine()->set_index(request.frame().coarse().index());
      response.mutable_frame()->mutable_fine()->set_time_s(sum);
      if (makes_checkpoints && frames % open.checkpoint_interval() == 0) {
        std::ostringstream text;
        text << frames << ' ' << sum;
        response.set_checkpoint(text.str());
      }
      stream->Write(response);
    }
    return grpc::Status::OK;
  }

  std::atomic<int> breaks_after = 0;  ///< frames; 0: never
  std::atomic<int> refuses = 0;
  grpc::Status refusal{grpc::StatusCode::UNAVAILABLE, "not yet"};
  std::atomic<bool> makes_checkpoints = true;
  std::string fine_hash = "fine";
  std::atomic<int> opens = 0;
  std::atomic<std::uint64_t> resumed_at = 0;
};

class SessionStreamTest : public ::testing::Test {
 protected:
  SessionStreamTest() { start(); }
  ~SessionStreamTest() override { server_->Shutdown(std::chrono::system_clock::now()); }

  void start() {
    grpc::ServerBuilder builder;
    builder.AddListeningPort(address_, grpc::InsecureServerCredentials());
    builder.RegisterService(&coordinator_);
    server_ = builder.BuildAndStart();
    ASSERT_NE(server_, nullptr);
  }
  void stop() {
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
  }

  std::unique_ptr<SessionStream> open(std::chrono::milliseconds patience = 20s) {
    SessionStream::Options options;
    options.stream.peer = "coordinator";
    options.stream.window = 4;
    options.patience = patience;
    options.away = [this] { ++away_; };
    v1::EnhanceRequest request;
    request.mutable_open()->set_window(4);
    return std::make_unique<SessionStream>(
        [stub = std::shared_ptr(v1::Coordinator::NewStub(rpc::create_channel(address_)))](auto* context, auto* call) {
          stub->async()->Enhance(context, call);
        },
        std::move(options), std::move(request));
  }
  static SessionStream::Request frame(SessionStream& stream, std::uint64_t index) {
    auto request = stream.spare();
    request->mutable_frame()->mutable_coarse()->set_index(index);
    request->mutable_frame()->mutable_coarse()->set_time_s(static_cast<double>(index + 1));
    return request;
  }
  static void expect_answer(SessionStream& stream, std::uint64_t index) {
    v1::EnhanceResponse response;
    ASSERT_TRUE(stream.pop(&response));
    EXPECT_EQ(response.frame().fine().index(), index);
    const auto n = static_cast<double>(index + 1);
    EXPECT_EQ(response.frame().fine().time_s(), n * (n + 1) / 2) << "frame " << index;
  }
  /// Frames first to end - 1 as the window allows, in one thread.
  static void exchange(SessionStream& stream, std::uint64_t first, std::uint64_t end) {
    std::uint64_t sent = first;
    SessionStream::Request request;
    for (std::uint64_t i = first; i < end; ++i) {
      for (; sent < end; ++sent) {
        if (!request) request = frame(stream, sent);
        if (!stream.try_push(request)) break;
      }
      expect_answer(stream, i);
    }
  }

  const test::TemporaryFolder folder_;
  const std::string address_ = "unix:" + (folder_.path() / "socket").string();
  SummingCoordinator coordinator_;
  std::unique_ptr<grpc::Server> server_;
  std::atomic<int> away_ = 0;
};

TEST_F(SessionStreamTest, EveryAnswerComesOnceWhereverTheCoordinatorGoes) {
  for (const int breaks_after : {1, 4, 25, 26, 27, 52, 99, 100}) {
    coordinator_.opens = 0;
    coordinator_.breaks_after = breaks_after;
    const auto stream = open();
    exchange(*stream, 0, 100);
    stream->close();
    v1::EnhanceResponse response;
    EXPECT_FALSE(stream->pop(&response));
    EXPECT_EQ(coordinator_.opens, 2) << breaks_after;
    // A write that fails may be met before the last answers are read, and a checkpoint goes with them.
    EXPECT_EQ(coordinator_.resumed_at % 25, 0U);
    EXPECT_LT(coordinator_.resumed_at, static_cast<std::uint64_t>(breaks_after));
  }
}

TEST_F(SessionStreamTest, OneThreadMayPushWhileAnotherPops) {
  const auto stream = open();
  std::thread pusher([&] {
    for (std::uint64_t i = 0; i < 300; ++i) stream->push(frame(*stream, i));
    stream->close();
  });
  for (std::uint64_t i = 0; i < 300; ++i) {
    if (i % 37 == 20) coordinator_.breaks_after = 3;
    expect_answer(*stream, i);
  }
  pusher.join();
  v1::EnhanceResponse response;
  EXPECT_FALSE(stream->pop(&response));
  EXPECT_GT(coordinator_.opens, 4);
}

TEST_F(SessionStreamTest, ACoordinatorThatIsStartedAgainIsFound) {
  const auto stream = open();
  exchange(*stream, 0, 30);
  stop();
  std::thread starter([&] {
    while (away_ < 2) std::this_thread::sleep_for(1ms);
    start();
  });
  exchange(*stream, 30, 60);
  starter.join();
  EXPECT_EQ(coordinator_.resumed_at, 25U);
}

TEST_F(SessionStreamTest, PatienceHasAnEnd) {
  const auto stream = open(300ms);
  exchange(*stream, 0, 2);
  coordinator_.refuses = 1'000'000;
  coordinator_.breaks_after = 1;
  auto request = frame(*stream, 2);
  ASSERT_TRUE(stream->try_push(request));
  v1::EnhanceResponse response;
  const Error error = test::error_of([&] { stream->pop(&response); });
  EXPECT_EQ(error.code(), ErrorCode::kUnavailable);
  EXPECT_NE(std::string(error.what()).find("not yet; not back after 300 ms"), std::string::npos) << error.what();
  coordinator_.refuses = 0;
  EXPECT_EQ(test::error_of([&] { stream->push(frame(*stream, 3)); }).code(), ErrorCode::kUnavailable)
      << "the session is over";
}

TEST_F(SessionStreamTest, WhatWaitingCantMendIsNotWaitedFor) {
  const auto lost = open(0ms);
  coordinator_.breaks_after = 1;
  lost->push(frame(*lost, 0));
  v1::EnhanceResponse response;
  EXPECT_EQ(test::error_of([&] { lost->pop(&response); }).code(), ErrorCode::kUnavailable) << "no patience at all";

  const auto stream = open();
  exchange(*stream, 0, 2);
  coordinator_.refusal = {grpc::StatusCode::FAILED_PRECONDITION, "another bundle"};
  coordinator_.refuses = 1;
  coordinator_.breaks_after = 1;
  stream->push(frame(*stream, 2));
  EXPECT_EQ(test::error_of([&] { stream->pop(&response); }).code(), ErrorCode::kFailedPrecondition);

  const auto other = open();
  coordinator_.fine_hash = "another";
  coordinator_.breaks_after = 1;
  other->push(frame(*other, 0));
  EXPECT_EQ(test::error_of([&] { other->pop(&response); }).code(), ErrorCode::kFailedPrecondition)
      << "the answers would be of another mesh";
}

TEST_F(SessionStreamTest, CancellingEndsTheWait) {
  const auto stream = open(60s);
  exchange(*stream, 0, 2);
  stop();
  std::thread canceller([&] {
    while (away_ == 0) std::this_thread::sleep_for(1ms);
    stream->cancel();
  });
  v1::EnhanceResponse response;
  EXPECT_EQ(test::error_of([&] { stream->pop(&response); }).code(), ErrorCode::kCancelled);
  canceller.join();
  start();
}

TEST_F(SessionStreamTest, WithoutCheckpointsAShortSessionGoesOnAndALongOneEnds) {
  coordinator_.makes_checkpoints = false;
  const auto stream = open();
  exchange(*stream, 0, 60);
  coordinator_.breaks_after = 1;
  exchange(*stream, 60, 300);
  EXPECT_EQ(coordinator_.resumed_at, 0U);
  EXPECT_EQ(coordinator_.opens, 2);
  coordinator_.breaks_after = 1;
  stream->push(frame(*stream, 300));
  v1::EnhanceResponse response;
  EXPECT_EQ(test::error_of([&] { stream->pop(&response); }).code(), ErrorCode::kUnavailable)
      << "not every frame is kept for ever";
}

}  // namespace
}  // namespace pleat::client
