#include <gtest/gtest.h>

#include "services/coordinator/job_feed.hpp"

namespace pleat::coordinator {
namespace {

JobFeed::Event event(std::uint64_t index, int values = 1) {
  auto made = std::make_shared<v1::JobEvent>();
  made->mutable_frame()->mutable_fine()->set_index(index);
  made->mutable_frame()->mutable_fine()->mutable_positions()->Resize(values, 1.0F);
  return made;
}

TEST(JobFeed, KeepsTheNewest) {
  JobFeed feed(3);
  for (std::uint64_t i = 5; i < 10; ++i) feed.publish(i, event(i));
  EXPECT_EQ(feed.frame(6), nullptr);
  for (std::uint64_t i = 7; i < 10; ++i) {
    ASSERT_NE(feed.frame(i), nullptr);
    EXPECT_EQ(feed.frame(i)->frame().fine().index(), i);
  }
  EXPECT_EQ(feed.frame(10), nullptr);
}

TEST(JobFeed, IsBoundedByBytesToo) {
  JobFeed feed(100, 5000);
  for (std::uint64_t i = 0; i < 10; ++i) feed.publish(i, event(i, 500));
  EXPECT_EQ(feed.frame(7), nullptr);
  EXPECT_NE(feed.frame(9), nullptr);
  feed.publish(10, event(10, 100'000));
  EXPECT_EQ(feed.frame(9), nullptr);
  EXPECT_NE(feed.frame(10), nullptr) << "the newest stays whatever its size";
}

}  // namespace
}  // namespace pleat::coordinator
