#include "services/superres/kernels/team.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <vector>

namespace pleat::superres {
namespace {

TEST(Team, MembersMeetAtBarriers) {
  constexpr int kMembers = 4, kRounds = 200;
  kernels::Team team(kMembers);
  std::atomic<int> early{0};
  std::vector<std::atomic<int>> rounds(kMembers);
  for (int task = 0; task < 3; ++task) {
    for (auto& round : rounds) round = 0;
    team.run([&](int member) {
      for (int round = 1; round <= kRounds; ++round) {
        rounds[static_cast<std::size_t>(member)] = round;
        team.barrier();
        for (const auto& other : rounds) early += other.load() < round ? 1 : 0;
        team.barrier();
      }
    });
    for (const auto& round : rounds) EXPECT_EQ(round.load(), kRounds);
  }
  EXPECT_EQ(early.load(), 0);
}

}  // namespace
}  // namespace pleat::superres
