#include "services/dataset/workers.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

namespace pleat::dataset {
namespace {

using Kind = WorkerEvent::Kind;
constexpr std::chrono::milliseconds kForever{-1};

struct Collected {
  std::vector<WorkerEvent> events;
  void wait(WorkerPool& pool) {
    while (pool.size() > 0) pool.wait(kForever, [this](const WorkerEvent& event) { events.push_back(event); });
  }
};

TEST(WorkerPool, SaysWhatItsProcessesSay) {
  WorkerPool pool;
  Collected collected;
  pool.start(3, [](const auto& on_frame, const auto&) {
    on_frame(1);
    on_frame(2);
    return SequenceReport{.cut_steps = 7};
  });
  collected.wait(pool);
  ASSERT_EQ(collected.events.size(), 3u);
  EXPECT_EQ(collected.events[1].frames, 2u);
  EXPECT_EQ(collected.events[2].kind, Kind::kDone);
  EXPECT_EQ(collected.events[2].plan, 3u);
  EXPECT_NE(collected.events[2].text.find("7 steps cut"), std::string::npos) << collected.events[2].text;
}

TEST(WorkerPool, FailuresComeWithTheirCauseOnce) {
  WorkerPool pool;
  Collected collected;
  pool.start(0, [](const auto&, const auto&) -> SequenceReport { throw Error(ErrorCode::kDataLoss, "the cause"); });
  collected.wait(pool);
  ASSERT_EQ(collected.events.size(), 1u);
  EXPECT_EQ(collected.events[0].kind, Kind::kFailed);
  EXPECT_EQ(collected.events[0].error->code(), ErrorCode::kDataLoss);
  EXPECT_EQ(collected.events[0].text, "the cause");
}

TEST(WorkerPool, AProcessThatDiesWithoutAWordHasFailed) {
  WorkerPool pool;
  Collected collected;
  pool.start(0, [](const auto&, const auto&) -> SequenceReport {
    ::raise(SIGKILL);
    return {};
  });
  collected.wait(pool);
  ASSERT_EQ(collected.events.size(), 1u);
  EXPECT_EQ(collected.events[0].kind, Kind::kFailed);
  EXPECT_NE(collected.events[0].text.find("Killed"), std::string::npos) << collected.events[0].text;
}

TEST(WorkerPool, StopReachesAllAndSignalsDoNot) {
  WorkerPool pool(WorkerPool::Signals::kIgnored);
  for (const std::size_t plan : {0u, 1u}) {
    pool.start(plan, [](const auto& on_frame, const auto& stopped) {
      ::raise(SIGTERM);
      on_frame(1);
      while (!stopped()) ::usleep(1000);
      return SequenceReport{.interrupted = true};
    });
  }
  Collected collected;
  while (collected.events.size() < 2) {
    pool.wait(kForever, [&](const WorkerEvent& event) { collected.events.push_back(event); });
  }
  pool.stop();
  collected.wait(pool);
  ASSERT_EQ(collected.events.size(), 4u);
  EXPECT_EQ(collected.events[2].kind, Kind::kInterrupted);
  EXPECT_EQ(collected.events[3].kind, Kind::kInterrupted);
}

TEST(WorkerPool, WhatIsKilledSaysNothing) {
  WorkerPool pool;
  pool.start(5, [](const auto&, const auto&) -> SequenceReport {
    while (true) ::pause();
  });
  pool.kill(5);
  EXPECT_EQ(pool.size(), 0u);
  pool.kill(5);
  pool.wait(std::chrono::milliseconds(0), [](const WorkerEvent&) { ADD_FAILURE(); });
}

}  // namespace
}  // namespace pleat::dataset
