#include <gtest/gtest.h>

#include <atomic>
#include <barrier>
#include <fstream>
#include <iterator>
#include <thread>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/lease.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

using namespace std::chrono_literals;

class LeaseTest : public ::testing::Test {
 protected:
  LeaseFolder participant(std::chrono::milliseconds expiry = 10s) {
    return {temporary.path() / "leases", expiry, [this] { return now; }};
  }

  const test::TemporaryFolder temporary;
  std::chrono::steady_clock::time_point now{};
};

TEST_F(LeaseTest, WhatIsHeldIsNotGivenAgain) {
  LeaseFolder one = participant(), other = participant();
  const auto lease = one.claim("a");
  ASSERT_TRUE(lease.has_value());
  EXPECT_EQ(lease->name(), "a");
  EXPECT_EQ(lease->generation(), 1u);
  EXPECT_FALSE(other.claim("a").has_value());
  EXPECT_FALSE(one.claim("a").has_value()) << "nor to its holder";
  EXPECT_TRUE(other.claim("b").has_value());
}

TEST_F(LeaseTest, WhatIsReleasedIsFree) {
  LeaseFolder one = participant(), other = participant();
  auto lease = one.claim("a");
  ASSERT_TRUE(lease.has_value());
  lease->release();
  const auto next = other.claim("a");
  ASSERT_TRUE(next.has_value());
  EXPECT_EQ(next->generation(), 2u);
}

TEST_F(LeaseTest, ARenewedClaimNeverExpires) {
  LeaseFolder one = participant(), other = participant();
  auto lease = one.claim("a");
  ASSERT_TRUE(lease.has_value());
  EXPECT_FALSE(other.claim("a").has_value());
  EXPECT_EQ(other.holder("a"), Holder::kUnknown);
  for (int i = 0; i < 20; ++i) {
    now += 6s;
    EXPECT_TRUE(lease->renew());
    EXPECT_FALSE(other.claim("a").has_value()) << i;
    EXPECT_EQ(other.holder("a"), Holder::kAlive);
  }
}

TEST_F(LeaseTest, ASilentClaimIsTakenOverAfterTheExpiryThatItsHolderPromised) {
  LeaseFolder one = participant(10s), other = participant(1s);
  auto lease = one.claim("a");
  ASSERT_TRUE(lease.has_value());
  now += 100s;  // nobody looked meanwhile
  EXPECT_FALSE(other.claim("a").has_value()) << "a first look tells nothing";
  now += 9s;
  EXPECT_FALSE(other.claim("a").has_value());
  now += 1s;
  const auto next = other.claim("a");
  ASSERT_TRUE(next.has_value());
  EXPECT_EQ(next->generation(), 2u);
  EXPECT_FALSE(lease->renew()) << "its holder learns that it is gone";
}

TEST_F(LeaseTest, WhoLostDoesNotDisturbTheNextHolder) {
  LeaseFolder one = participant(), other = participant();
  auto lost = one.claim("a");
  ASSERT_TRUE(lost.has_value());
  EXPECT_FALSE(other.claim("a").has_value());
  now += 10s;
  ASSERT_TRUE(other.claim("a").has_value());
  lost->release();
  EXPECT_FALSE(one.claim("a").has_value());
}

TEST_F(LeaseTest, AClaimWithoutContentExpiresToo) {
  LeaseFolder one = participant();
  std::ofstream(temporary.path() / "leases/a.1");  // its maker died between making and writing
  EXPECT_FALSE(one.claim("a").has_value());
  now += 10s;
  EXPECT_TRUE(one.claim("a").has_value());
}

// Each participant is what a process is: it shares the folder and nothing else.
TEST_F(LeaseTest, OfManyWhoClaimAtOnceOneWins) {
  constexpr int kParticipants = 8, kNames = 100;
  std::vector<LeaseFolder> participants;
  for (int i = 0; i < kParticipants; ++i) participants.push_back(participant());
  std::vector<std::atomic<int>> fresh(kNames), taken_over(kNames);
  std::barrier step(kParticipants);
  std::atomic<int> advance{0};
  std::vector<std::thread> threads;
  for (LeaseFolder& each : participants) {
    threads.emplace_back([&] {
      for (int round = 0; round < 2; ++round) {
        for (int n = 0; n < kNames; ++n) {
          step.arrive_and_wait();
          if (each.claim(std::to_string(n))) ++(round == 0 ? fresh : taken_over)[n];
        }
        // All see what is held before it expires.
        for (int n = 0; n < kNames; ++n) static_cast<void>(each.claim(std::to_string(n)));
        step.arrive_and_wait();
        if (advance++ % kParticipants == 0) now += 10s;
        step.arrive_and_wait();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (int n = 0; n < kNames; ++n) {
    EXPECT_EQ(fresh[n], 1) << n;
    EXPECT_EQ(taken_over[n], 1) << n;
  }
}

TEST_F(LeaseTest, WhatCanNotBeIsRefusedByName) {
  LeaseFolder one = participant();
  EXPECT_THROW(one.claim(""), Error);
  EXPECT_THROW(one.claim("a/b"), Error);
  EXPECT_THROW(participant(0ms), Error);
  std::ofstream(temporary.path() / "file");
  EXPECT_THROW(LeaseFolder(temporary.path() / "file", 10s), Error);
  std::filesystem::remove_all(temporary.path() / "leases");
  try {
    one.claim("a");
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("a.1"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace pleat
