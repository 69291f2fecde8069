#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "common/base/parallel.hpp"

namespace pleat {
namespace {

TEST(ThreadPool, VisitsEveryIndexOnce) {
  for (const std::size_t threads : {1u, 2u, 5u}) {
    ThreadPool pool(threads);
    EXPECT_EQ(pool.size(), threads);
    for (const std::size_t count : {0u, 1u, 7u, 1000u}) {
      for (const std::size_t grain : {0u, 1u, 3u, 2000u}) {
        std::vector<std::atomic<int>> visits(count);
        pool.parallel_for(count, grain, [&](std::size_t begin, std::size_t end) {
          for (std::size_t i = begin; i < end; ++i) ++visits[i];
        });
        for (const auto& visit : visits) ASSERT_EQ(visit.load(), 1) << count << " indices in ranges of " << grain;
      }
    }
  }
}

// Sums that depend on the order of addition must not depend on the number of threads.
TEST(ThreadPool, RangesDoNotDependOnTheNumberOfThreads) {
  const auto sum = [](std::size_t threads) {
    ThreadPool pool(threads);
    constexpr std::size_t kCount = 100'000, kGrain = 1'000;
    std::vector<float> partial(kCount / kGrain);
    pool.parallel_for(kCount, kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) partial[begin / kGrain] += std::sin(static_cast<float>(i));
    });
    float total = 0;
    for (const float value : partial) total += value;
    return total;
  };
  const float one = sum(1);
  EXPECT_EQ(one, sum(2));
  EXPECT_EQ(one, sum(7));
}

TEST(ThreadPool, PassesOnAnExceptionAndStaysUsable) {
  ThreadPool pool(3);
  EXPECT_THROW(pool.parallel_for(100, 1,
                                 [](std::size_t begin, std::size_t) {
                                   if (begin == 42) throw std::runtime_error("42");
                                 }),
               std::runtime_error);
  std::atomic<int> visits{0};
  pool.parallel_for(100, 1, [&](std::size_t, std::size_t) { ++visits; });
  EXPECT_EQ(visits.load(), 100);
}

TEST(ThreadPool, ManyShortLoops) {
  ThreadPool pool(2);
  std::vector<int> values(64, 0);
  for (int round = 0; round < 5'000; ++round) {
    pool.parallel_for(values.size(), 8, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) ++values[i];
    });
  }
  for (const int value : values) ASSERT_EQ(value, 5'000);
}

TEST(Processors, AtLeastOne) { EXPECT_GE(available_processors(), 1u); }

}  // namespace
}  // namespace pleat
