#include "common/rpc/caller.hpp"

#include <gtest/gtest.h>

namespace pleat::rpc {
namespace {

TEST(Caller, AHostIsOneWhateverThePort) {
  EXPECT_EQ(host_of_peer("ipv4:10.0.0.7:4242"), "ipv4:10.0.0.7");
  EXPECT_EQ(host_of_peer("ipv6:%5B::1%5D:4242"), "ipv6:%5B::1%5D");
  EXPECT_EQ(host_of_peer("unix:"), "unix");
  EXPECT_EQ(host_of_peer("unix:/tmp/client.sock"), "unix");
  EXPECT_EQ(host_of_peer("ipv4:"), "ipv4:");
}

}  // namespace
}  // namespace pleat::rpc
