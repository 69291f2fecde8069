#include "services/coordinator/client_quota.hpp"

#include <gtest/gtest.h>

namespace pleat::coordinator {
namespace {

std::string refusal(ClientQuota& quota, const std::string& client) {
  try {
    quota.enter(client);
    return "";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kResourceExhausted);
    return error.what();
  }
}

TEST(ClientQuota, NobodyHasMoreThanHisShare) {
  ClientQuota quota("live sessions", 3, 2);
  EXPECT_EQ(refusal(quota, "a"), "");
  EXPECT_EQ(refusal(quota, "a"), "");
  EXPECT_EQ(refusal(quota, "a"), "a has 2 live sessions already");
  EXPECT_EQ(refusal(quota, "b"), "");
  EXPECT_EQ(refusal(quota, "c"), "there are 3 live sessions already");
  quota.leave("a");
  EXPECT_EQ(refusal(quota, "a"), "");
}

TEST(ClientQuota, WithoutAShareAllMayBeOnes) {
  ClientQuota quota("watchers of jobs", 2, 0);
  EXPECT_EQ(refusal(quota, "a"), "");
  EXPECT_EQ(refusal(quota, "a"), "");
  EXPECT_NE(refusal(quota, "b"), "");
}

}  // namespace
}  // namespace pleat::coordinator
