#include "services/coordinator/replica_choice.hpp"

#include <gtest/gtest.h>

namespace pleat::coordinator {
namespace {

const std::vector<std::string> kReplicas{"a", "b", "c"};

TEST(ReplicaChoice, ASessionGoesWhereFewestAre) {
  const auto directory = std::make_shared<ReplicaDirectory>();
  const LoadShare first(directory->load_of("a"), &ReplicaLoad::sessions);
  {
    const LoadShare second(directory->load_of("b"), &ReplicaLoad::sessions);
    EXPECT_EQ(ReplicaChoice(directory, 0).next(kReplicas), "c");
  }
  EXPECT_EQ(ReplicaChoice(directory, 0).next(kReplicas), "b") << "its session has ended";
}

TEST(ReplicaChoice, EqualsTakeTurns) {
  for (std::size_t turn = 0; turn < 6; ++turn)
    EXPECT_EQ(ReplicaChoice(nullptr, turn).next(kReplicas), kReplicas[turn % 3]);
}

TEST(ReplicaChoice, ReplicasThatAreDownDoNotHideTheBusyOne) {
  const auto directory = std::make_shared<ReplicaDirectory>();
  std::vector<std::unique_ptr<LoadShare>> sessions;
  for (int i = 0; i < 5; ++i)
    sessions.push_back(std::make_unique<LoadShare>(directory->load_of("c"), &ReplicaLoad::sessions));
  ReplicaChoice choice(directory, 0);
  std::vector<std::string> tried;
  for (int i = 0; i < 6; ++i) tried.push_back(choice.next(kReplicas));
  EXPECT_EQ(tried[0] + tried[1] + tried[2], "abc");
  EXPECT_EQ(tried[3] + tried[4] + tried[5], "abc") << "and all over again";
}

TEST(ReplicaChoice, WhoServedAndFailedComesLast) {
  ReplicaChoice choice(std::make_shared<ReplicaDirectory>(), 0);
  EXPECT_EQ(choice.next(kReplicas), "a");
  choice.served();
  EXPECT_EQ(choice.next(kReplicas), "b");
  EXPECT_EQ(choice.next(kReplicas), "c");
  EXPECT_EQ(choice.next(kReplicas), "a");
}

TEST(ReplicaChoice, ReplicasThatAreGoneAreNotTried) {
  ReplicaChoice choice(nullptr, 0);
  EXPECT_EQ(choice.next(kReplicas), "a");
  EXPECT_EQ(choice.next({"c"}), "c");
  EXPECT_EQ(choice.next({"d"}), "d");
}

}  // namespace
}  // namespace pleat::coordinator
