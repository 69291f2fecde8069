#include "common/rpc/shared_frames.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <thread>

#include "pleat/v1/refinement.pb.h"
#include "tests/support/raw_stream.hpp"

namespace pleat::rpc {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

v1::RefineRequest frame_of(std::uint64_t index, int values = 30) {
  v1::RefineRequest request;
  request.mutable_frame()->mutable_coarse()->set_index(index);
  for (int i = 0; i < values; ++i) request.mutable_frame()->mutable_fine()->add_positions(static_cast<float>(i));
  return request;
}

struct Pair {
  explicit Pair(std::uint32_t window = 4)
      : client(SharedFrames::offer(window)), server(SharedFrames::accept(client->ticket(), window)) {}
  std::unique_ptr<SharedFrames> client, server;
};

TEST(SharedFrames, GoBothWaysInOrder) {
  const Pair pair;
  ASSERT_NE(pair.server, nullptr);
  v1::RefineRequest got;
  for (std::uint64_t k = 0; k < 300; ++k) {
    EXPECT_FALSE(pair.server->available());
    for (std::uint64_t i = 0; i < 3; ++i) ASSERT_TRUE(pair.client->send(frame_of(3 * k + i, static_cast<int>(k))));
    EXPECT_EQ(pair.client->on_their_way(), 3u);
    for (std::uint64_t i = 0; i < 3; ++i) {
      ASSERT_TRUE(pair.server->available());
      ASSERT_TRUE(pair.server->receive(&got));
      EXPECT_EQ(got.SerializeAsString(), frame_of(3 * k + i, static_cast<int>(k)).SerializeAsString());
    }
    ASSERT_TRUE(pair.server->send(got));
    ASSERT_TRUE(pair.client->receive(&got));
    EXPECT_EQ(got.frame().coarse().index(), 3 * k + 2);
  }
  EXPECT_EQ(pair.client->taken(), 900u);
}

TEST(SharedFrames, TakesWhatTheWindowAllows) {
  const Pair pair(2);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(pair.client->send(frame_of(0)));
  EXPECT_FALSE(pair.client->send(frame_of(0))) << "one more than the window for what is no frame";
  v1::RefineRequest got;
  ASSERT_TRUE(pair.server->receive(&got));
  EXPECT_TRUE(pair.client->send(frame_of(0)));
  EXPECT_FALSE(pair.client->send(frame_of(0, (64 << 20) / 4))) << "larger than any message may be";
}

TEST(SharedFrames, ClosedAfterWhatWasSent) {
  const Pair pair;
  EXPECT_FALSE(pair.server->closed());
  ASSERT_TRUE(pair.client->send(frame_of(7)));
  pair.client->close();
  EXPECT_TRUE(pair.server->closed());
  EXPECT_TRUE(pair.server->available());
  EXPECT_FALSE(pair.client->closed());
}

TEST(SharedFrames, ARingWakesUp) {
  const Pair pair;
  const std::uint32_t before = pair.server->rings();
  EXPECT_FALSE(pair.server->wait(before, Clock::now() + 1ms));
  std::thread sender([&] { pair.client->send(frame_of(1)); });
  EXPECT_TRUE(pair.server->wait(before, Clock::now() + 60s));
  sender.join();
  EXPECT_TRUE(pair.server->available());
  const std::uint32_t then = pair.server->rings();
  pair.server->ring();
  EXPECT_TRUE(pair.server->wait(then, Clock::now() + 60s)) << "rung before it waits";
}

/// Receives `count` messages and answers each; true if it may run afterwards where it could before.
bool answer_all(SharedFrames& side, int count) {
  cpu_set_t before, after;
  sched_getaffinity(0, sizeof(before), &before);
  v1::RefineRequest got;
  for (int k = 0; k < count; ++k) {
    for (std::uint32_t rings = side.rings(); !side.available(); rings = side.rings())
      side.wait(rings, Clock::now() + 1s);
    if (!side.receive(&got) || !side.send(got)) return false;
  }
  sched_getaffinity(0, sizeof(after), &after);
  return CPU_EQUAL(&before, &after) != 0;
}

TEST(SharedFrames, WhoIsWokenUpRunsWhereItCouldBefore) {
  const Pair pair;
  bool client_as_before = false, server_as_before = false;
  ASSERT_TRUE(pair.client->send(frame_of(0)));
  std::thread client([&] { client_as_before = answer_all(*pair.client, 500); });
  std::thread server([&] { server_as_before = answer_all(*pair.server, 500); });
  client.join();
  server.join();
  EXPECT_TRUE(client_as_before);
  EXPECT_TRUE(server_as_before);
}

TEST(SharedFrames, BytesThatAreNoMessageAreSaidToBeNone) {
  const Pair pair;
  ASSERT_TRUE(pair.client->send(test::with_first_field("\x0f")));
  ASSERT_TRUE(pair.client->send(frame_of(5)));
  v1::RefineRequest got = frame_of(1);
  EXPECT_FALSE(pair.server->receive(&got));
  EXPECT_TRUE(pair.server->receive(&got)) << "the next one is";
  EXPECT_EQ(got.frame().coarse().index(), 5u);
}

TEST(SharedFrames, OnlyWhatWasOfferedIsAccepted) {
  const auto client = SharedFrames::offer(4);
  const std::string& ticket = client->ticket();
  EXPECT_EQ(SharedFrames::accept(ticket, 5), nullptr) << "another size";
  std::string wrong = ticket;
  wrong.back() = wrong.back() == '0' ? '1' : '0';
  EXPECT_EQ(SharedFrames::accept(wrong, 4), nullptr) << "another token";
  for (const std::string& text : {std::string(), std::string("x"), std::string("1 2"), std::string("-1 3 ab"),
                                  std::to_string(getpid()) + " 999999 " + ticket.substr(ticket.rfind(' ') + 1),
                                  std::to_string(getpid()) + " 0 " + ticket.substr(ticket.rfind(' ') + 1)}) {
    EXPECT_EQ(SharedFrames::accept(text, 4), nullptr) << text;
  }
  // A file of the right size, which its owner could cut.
  const auto path = std::filesystem::temp_directory_path() / ("pleat-test-shared-" + std::to_string(getpid()));
  const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  std::filesystem::remove(path);
  ASSERT_GE(file, 0);
  ASSERT_EQ(::ftruncate(file, 4096 + 10 * (64ll << 20)), 0);
  EXPECT_EQ(SharedFrames::accept(std::to_string(getpid()) + " " + std::to_string(file) + " " + std::string(32, '0'), 4),
            nullptr);
  ::close(file);
  EXPECT_NE(SharedFrames::accept(ticket, 4), nullptr);
}

TEST(SharedFrames, AProcessThatMayHaveNoLargeFileHasNone) {
  const pid_t child = fork();
  if (child == 0) {
    const rlimit limit{1 << 20, 1 << 20};
    setrlimit(RLIMIT_FSIZE, &limit);
    _exit(SharedFrames::offer(4) == nullptr ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0) << "not killed, and nothing offered";
}

TEST(SharedFrames, WithdrawnNobodyCanTakeThemUp) {
  const Pair pair;
  pair.client->withdraw();
  EXPECT_EQ(SharedFrames::accept(pair.client->ticket(), 4), nullptr);
  v1::RefineRequest got;
  ASSERT_TRUE(pair.client->send(frame_of(2)));
  EXPECT_TRUE(pair.server->receive(&got)) << "who has them keeps them";
}

TEST(SharedFrames, WhatAProcessSentOutlivesIt) {
  const auto client = SharedFrames::offer(4);
  const pid_t child = fork();
  if (child == 0) {
    const auto server = SharedFrames::accept(client->ticket(), 4);
    _exit(server != nullptr && server->send(frame_of(9)) ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_EQ(status, 0);
  v1::RefineRequest got;
  ASSERT_TRUE(client->available());
  ASSERT_TRUE(client->receive(&got));
  EXPECT_EQ(got.frame().coarse().index(), 9u);
}

}  // namespace
}  // namespace pleat::rpc
