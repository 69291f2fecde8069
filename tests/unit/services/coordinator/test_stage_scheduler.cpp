#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <random>
#include <set>
#include <thread>

#include "services/coordinator/backoff.hpp"
#include "services/coordinator/stage_scheduler.hpp"

namespace pleat::coordinator {
namespace {

using namespace std::chrono_literals;

struct Item {
  std::uint64_t sequence = 0;
  std::shared_ptr<const std::uint64_t> work;
  bool given_up = false;
};

std::unique_ptr<Item> item(std::uint64_t sequence) {
  auto made = std::make_unique<Item>();
  made->sequence = sequence;
  made->work = std::make_shared<std::uint64_t>(sequence);
  return made;
}

class StageSchedulerTest : public ::testing::Test {
 protected:
  void make(StageLimits limits, std::uint64_t first = 0) {
    scheduler_ = std::make_unique<StageScheduler<Item>>(
        limits, first, [this](std::unique_ptr<Item> done) { delivered_.push_back(done->sequence); },
        [this] { drained_ = true; });
  }
  bool answer(std::size_t replica, std::uint64_t sequence) {
    std::chrono::duration<double> time{};
    auto answered = scheduler_->answered(replica, sequence, time);
    if (!answered) return false;
    scheduler_->complete(std::move(answered));
    return true;
  }

  std::unique_ptr<StageScheduler<Item>> scheduler_;
  std::vector<std::uint64_t> delivered_;
  bool drained_ = false;
};

TEST_F(StageSchedulerTest, DeliversInSequenceWhateverTheOrderOfAnswers) {
  make({.replicas = 1, .window = 4});
  scheduler_->connected(0);
  for (std::uint64_t i = 0; i < 4; ++i) scheduler_->push(item(i));
  for (std::uint64_t i = 0; i < 4; ++i) EXPECT_EQ(*scheduler_->take(0), i);
  EXPECT_TRUE(answer(0, 2));
  EXPECT_TRUE(answer(0, 1));
  EXPECT_TRUE(delivered_.empty());
  EXPECT_TRUE(answer(0, 0));
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{0, 1, 2}));
  EXPECT_TRUE(answer(0, 3));
  EXPECT_FALSE(answer(0, 3)) << "an answer counts once";
  EXPECT_EQ(delivered_.size(), 4U);
}

TEST_F(StageSchedulerTest, FramesGoWhereEverybodyHasLeastInFlight) {
  make({.replicas = 2, .window = 4});
  std::atomic<int> all[2] = {3, 1};
  const auto load = [&](int r) { return std::shared_ptr<const std::atomic<int>>(&all[r], [](const auto*) {}); };
  for (const int r : {0, 1}) scheduler_->connected(static_cast<std::size_t>(r), load(r));
  std::vector<std::size_t> taken;
  for (std::uint64_t i = 0; i < 6; ++i) {
    StageScheduler<Item>::Direct direct;
    ASSERT_TRUE(scheduler_->push(item(i), &direct));
    ASSERT_NE(direct.work, nullptr);
    scheduler_->sent(direct.replica);
    ++all[direct.replica];
    taken.push_back(direct.replica);
  }
  EXPECT_EQ(taken, (std::vector<std::size_t>{1, 1, 0, 1, 0, 1})) << "3 and 1 in flight: first up to the other's";
}

TEST_F(StageSchedulerTest, AReplicaThatIsBusyForOthersTakesWhatTheRestHasNoRoomFor) {
  make({.replicas = 2, .window = 1});
  std::atomic<int> busy{50};
  scheduler_->connected(0, std::shared_ptr<const std::atomic<int>>(&busy, [](const auto*) {}));
  scheduler_->connected(1);
  for (std::uint64_t i = 0; i < 2; ++i) scheduler_->push(item(i));
  EXPECT_EQ(*scheduler_->take(1), 0U);
  EXPECT_EQ(*scheduler_->take(0), 1U);
}

/// The load changes at any time, as seen by senders that wait for each other: nobody may be left waiting.
TEST_F(StageSchedulerTest, SendersAgreeWhateverTheLoadIs) {
  make({.replicas = 3, .window = 2});
  std::atomic<int> all[3] = {};
  std::atomic<bool> over{false};
  std::thread others([&] {
    std::minstd_rand random(1);
    while (!over) all[random() % 3] = static_cast<int>(random() % 5);
  });
  std::vector<std::thread> senders;
  for (std::size_t r = 0; r < 3; ++r) {
    scheduler_->connected(r, std::shared_ptr<const std::atomic<int>>(&all[r], [](const auto*) {}));
    senders.emplace_back([&, r] {
      while (const auto work = scheduler_->take(r)) answer(r, *work);
    });
  }
  for (std::uint64_t i = 0; i < 3000; ++i) ASSERT_TRUE(scheduler_->push(item(i)));
  scheduler_->close();
  for (std::thread& sender : senders) sender.join();
  over = true;
  others.join();
  EXPECT_EQ(delivered_.size(), 3000U);
  EXPECT_TRUE(drained_);
}

TEST_F(StageSchedulerTest, AReplicaThatLeavesAnswersWhatItHasAndGetsNoMore) {
  make({.replicas = 2, .window = 2});
  scheduler_->connected(0);
  for (std::uint64_t i = 0; i < 2; ++i) scheduler_->push(item(i));
  EXPECT_EQ(*scheduler_->take(0), 0U);
  scheduler_->leave(0);
  std::atomic<bool> left{false};
  std::thread sender([&] {
    EXPECT_EQ(scheduler_->take(0), nullptr);
    left = true;
  });
  scheduler_->connected(1);
  EXPECT_EQ(*scheduler_->take(1), 1U) << "though the other one waits for work, too";
  EXPECT_FALSE(left) << "it has not answered";
  EXPECT_TRUE(answer(0, 0));
  sender.join();
  EXPECT_TRUE(answer(1, 1));
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{0, 1}));
}

TEST_F(StageSchedulerTest, ThereIsRoomForWhatReplicasInUseMayHave) {
  make({.replicas = 3, .window = 1});
  scheduler_->use(1, false);
  scheduler_->use(2, false);
  scheduler_->use(2, false);
  EXPECT_TRUE(scheduler_->push(item(0)));
  std::atomic<bool> pushed{false};
  std::thread producer([&] {
    EXPECT_TRUE(scheduler_->push(item(1)));
    pushed = true;
  });
  EXPECT_FALSE(pushed);
  EXPECT_EQ(scheduler_->inside(), 1U);
  scheduler_->use(1, true);
  producer.join();
  EXPECT_EQ(scheduler_->inside(), 2U);
}

TEST_F(StageSchedulerTest, BrokenReplicaGivesItsWorkBackOldestFirst) {
  make({.replicas = 1, .window = 4}, 10);
  scheduler_->connected(0);
  for (std::uint64_t i = 10; i < 14; ++i) scheduler_->push(item(i));
  for (int i = 0; i < 3; ++i) scheduler_->take(0);
  answer(0, 11);
  EXPECT_EQ(scheduler_->broke_off(0), nullptr);
  EXPECT_EQ(scheduler_->take(0), nullptr) << "nothing for a replica that is not connected";
  EXPECT_FALSE(answer(0, 10)) << "an answer of the old connection is no answer";
  scheduler_->connected(0);
  EXPECT_EQ(*scheduler_->take(0), 10U);
  EXPECT_EQ(*scheduler_->take(0), 12U);
  EXPECT_EQ(*scheduler_->take(0), 13U);
  for (const std::uint64_t i : {13, 12, 10}) answer(0, i);
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{10, 11, 12, 13}));
}

TEST_F(StageSchedulerTest, AFrameThatKillsItsStageIsGivenUp) {
  make({.replicas = 1, .window = 2, .strikes = 3});
  scheduler_->push(item(0));
  scheduler_->push(item(1));
  for (int strike = 1; strike <= 3; ++strike) {
    scheduler_->connected(0);
    scheduler_->take(0);
    scheduler_->take(0);
    auto given_up = scheduler_->broke_off(0);
    ASSERT_EQ(given_up != nullptr, strike == 3);
    if (given_up) {
      EXPECT_EQ(given_up->sequence, 0U);
      scheduler_->complete(std::move(given_up));
    }
  }
  scheduler_->connected(0);
  EXPECT_EQ(*scheduler_->take(0), 1U);
  answer(0, 1);
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{0, 1}));
}

TEST_F(StageSchedulerTest, TheReplicaWithLeastInFlightTakes) {
  make({.replicas = 2, .window = 2});
  scheduler_->connected(0);
  scheduler_->connected(1);
  scheduler_->push(item(0));
  EXPECT_EQ(*scheduler_->take(0), 0U);
  // Replica 0 has one in flight and replica 1 none: 0 must leave the next one to 1, whoever waits longer.
  std::thread busy([&] { EXPECT_EQ(*scheduler_->take(0), 2U); });
  std::this_thread::sleep_for(20ms);
  scheduler_->push(item(1));
  EXPECT_EQ(*scheduler_->take(1), 1U);
  scheduler_->push(item(2));
  busy.join();
}

TEST_F(StageSchedulerTest, NobodyWaitsForASenderThatSends) {
  make({.replicas = 2, .window = 4});
  scheduler_->connected(0);
  scheduler_->connected(1);
  for (std::uint64_t i = 0; i < 4; ++i) scheduler_->push(item(i));
  EXPECT_EQ(*scheduler_->take(0), 0U);
  // What replica 0 was sent last may be stuck on its way: its sender does not come back.
  for (std::uint64_t i = 1; i < 4; ++i) EXPECT_EQ(*scheduler_->take(1), i);
}

TEST_F(StageSchedulerTest, ALostReplicasWorkGoesToTheOther) {
  make({.replicas = 2, .window = 2});
  scheduler_->connected(0);
  scheduler_->connected(1);
  scheduler_->push(item(0));
  scheduler_->push(item(1));
  scheduler_->take(0);
  scheduler_->take(1);
  EXPECT_EQ(scheduler_->broke_off(0), nullptr);
  EXPECT_EQ(scheduler_->live(), 1U);
  EXPECT_EQ(*scheduler_->take(1), 0U);
}

TEST_F(StageSchedulerTest, WhoPushesSendsWhatAReplicaCanTakeAtOnce) {
  using Direct = StageScheduler<Item>::Direct;
  make({.replicas = 1, .window = 4});
  scheduler_->connected(0);
  Direct first, second;
  scheduler_->push(item(0), &first);
  ASSERT_NE(first.work, nullptr);
  EXPECT_EQ(*first.work, 0U);
  scheduler_->push(item(1), &second);
  EXPECT_EQ(second.work, nullptr) << "requests keep their order";
  std::atomic<bool> taken{false};
  std::thread sender([&] {
    EXPECT_EQ(*scheduler_->take(0), 1U);
    taken = true;
  });
  std::this_thread::sleep_for(5ms);
  EXPECT_FALSE(taken);
  scheduler_->sent(0);
  sender.join();
  scheduler_->push(item(2), &second);
  EXPECT_EQ(second.work, nullptr) << "the sender may still be sending";
  EXPECT_EQ(*scheduler_->take(0), 2U);
  for (const std::uint64_t i : {0, 1, 2}) answer(0, i);
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{0, 1, 2}));
}

TEST_F(StageSchedulerTest, NobodySendsToAReplicaThatIsNotConnected) {
  make({.replicas = 1, .window = 4});
  StageScheduler<Item>::Direct direct;
  scheduler_->push(item(0), &direct);
  EXPECT_EQ(direct.work, nullptr);
  scheduler_->connected(0);
  scheduler_->push(item(1), &direct);
  EXPECT_EQ(direct.work, nullptr) << "an older one waits";
  EXPECT_EQ(*scheduler_->take(0), 0U);
  EXPECT_EQ(*scheduler_->take(0), 1U);
}

TEST_F(StageSchedulerTest, AReplicaIsLeftWhenNobodySendsToIt) {
  make({.replicas = 1, .window = 4});
  scheduler_->connected(0);
  StageScheduler<Item>::Direct direct;
  scheduler_->push(item(0), &direct);
  ASSERT_NE(direct.work, nullptr);
  scheduler_->disconnected(0);
  std::atomic<bool> left{false};
  std::thread leaving([&] {
    scheduler_->wait_sent(0);
    left = true;
  });
  std::this_thread::sleep_for(5ms);
  EXPECT_FALSE(left);
  scheduler_->sent(0);
  leaving.join();
  EXPECT_EQ(scheduler_->broke_off(0), nullptr);
  scheduler_->connected(0);
  EXPECT_EQ(*scheduler_->take(0), 0U) << "it is sent again";
}

TEST_F(StageSchedulerTest, HoldsNoMoreThanTheWindows) {
  make({.replicas = 1, .window = 2});
  scheduler_->connected(0);
  scheduler_->push(item(0));
  scheduler_->push(item(1));
  std::atomic<bool> pushed{false};
  std::thread producer([&] {
    scheduler_->push(item(2));
    pushed = true;
  });
  scheduler_->take(0);
  scheduler_->take(0);
  answer(0, 1);
  std::this_thread::sleep_for(20ms);
  EXPECT_FALSE(pushed) << "an answer that must wait for its turn makes no room";
  answer(0, 0);
  producer.join();
  EXPECT_TRUE(pushed);
}

TEST_F(StageSchedulerTest, ItemsThatNeedNoWorkKeepTheirPlace) {
  make({.replicas = 1, .window = 4});
  scheduler_->connected(0);
  scheduler_->push(item(0));
  scheduler_->pass(item(1));
  EXPECT_TRUE(delivered_.empty());
  scheduler_->take(0);
  answer(0, 0);
  EXPECT_EQ(delivered_, (std::vector<std::uint64_t>{0, 1}));
}

TEST_F(StageSchedulerTest, DrainsAfterCloseAndTheLastAnswer) {
  make({.replicas = 1, .window = 4});
  scheduler_->connected(0);
  scheduler_->push(item(0));
  scheduler_->close();
  EXPECT_FALSE(drained_);
  scheduler_->take(0);
  answer(0, 0);
  EXPECT_TRUE(drained_);
  EXPECT_TRUE(scheduler_->finished());
  EXPECT_EQ(scheduler_->take(0), nullptr);
}

TEST_F(StageSchedulerTest, StopFreesEveryWaiter) {
  make({.replicas = 1, .window = 1});
  scheduler_->connected(0);
  scheduler_->push(item(0));
  scheduler_->take(0);
  std::thread producer([&] { EXPECT_FALSE(scheduler_->push(item(1))); });
  std::thread sender([&] { EXPECT_EQ(scheduler_->take(0), nullptr); });
  std::this_thread::sleep_for(5ms);
  scheduler_->stop();
  producer.join();
  sender.join();
  EXPECT_FALSE(drained_);
}

// Three replicas with their two threads each, that break off at random: everything comes out once and in order.
TEST(StageScheduler, SurvivesRandomFaults) {
  constexpr std::uint64_t kItems = 800;
  std::vector<std::uint64_t> delivered;
  std::atomic<bool> drained{false};
  StageScheduler<Item> scheduler(
      {.replicas = 3, .window = 3, .strikes = 1'000'000}, 0,
      [&](std::unique_ptr<Item> done) { delivered.push_back(done->sequence); }, [&] { drained = true; });
  std::vector<std::thread> replicas;
  for (std::size_t r = 0; r < 3; ++r) {
    replicas.emplace_back([&, r] {
      std::minstd_rand random(static_cast<unsigned>(r + 1));
      while (!scheduler.finished()) {
        scheduler.connected(r);
        std::mutex mutex;
        std::set<std::uint64_t> sent;
        std::condition_variable arrived;
        bool sending = true;
        std::thread receiver([&] {
          std::minstd_rand choice(static_cast<unsigned>(r + 10));
          while (true) {
            std::uint64_t sequence = 0;
            {
              std::unique_lock lock(mutex);
              if (!arrived.wait_for(lock, 1s, [&] { return !sent.empty() || !sending; })) continue;
              if (sent.empty()) break;
              auto chosen = sent.begin();
              std::advance(chosen, choice() % sent.size());
              sequence = *chosen;
              sent.erase(chosen);
            }
            if (choice() % 50 == 0) break;
            std::chrono::duration<double> time{};
            auto answered = scheduler.answered(r, sequence, time);
            ASSERT_NE(answered, nullptr);
            scheduler.complete(std::move(answered));
          }
          scheduler.disconnected(r);
        });
        while (const auto work = scheduler.take(r)) {
          const std::lock_guard lock(mutex);
          sent.insert(*work);
          arrived.notify_all();
        }
        {
          const std::lock_guard lock(mutex);
          sending = false;
          arrived.notify_all();
        }
        receiver.join();
        scheduler.broke_off(r);
      }
    });
  }
  for (std::uint64_t i = 0; i < kItems; ++i) ASSERT_TRUE(scheduler.push(item(i)));
  scheduler.close();
  for (std::thread& replica : replicas) replica.join();
  EXPECT_TRUE(drained);
  ASSERT_EQ(delivered.size(), kItems);
  for (std::uint64_t i = 0; i < kItems; ++i) ASSERT_EQ(delivered[i], i);
}

TEST(Backoff, GrowsToItsLimitWithJitter) {
  Backoff backoff(100ms, 400ms, 1);
  for (const auto whole : {100ms, 200ms, 400ms, 400ms}) {
    const auto wait = backoff.next();
    EXPECT_GE(wait, whole / 2);
    EXPECT_LE(wait, whole);
  }
  backoff.reset();
  EXPECT_LE(backoff.next(), 100ms);
}

}  // namespace
}  // namespace pleat::coordinator
