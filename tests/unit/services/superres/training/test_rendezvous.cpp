#include "services/superres/training/rendezvous.hpp"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <thread>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

TEST(Rendezvous, APlaceHasAHostAndAPort) {
  for (const char* text : {"node-1:29500", "10.0.0.7:1", "[fe80::1]:65535"}) {
    EXPECT_TRUE(parse_rendezvous(text).has_value()) << text;
  }
  EXPECT_EQ(parse_rendezvous("[fe80::1]:5000")->host, "fe80::1");
  EXPECT_EQ(parse_rendezvous("node:29500")->port, 29500);
  for (const char* text :
       {"", "node", "node:", ":29500", "node:0", "node:65536", "node:12x", "out/rendezvous.12", "/shared/a:5000"}) {
    EXPECT_FALSE(parse_rendezvous(text).has_value()) << text;
  }
}

TEST(Rendezvous, LoopbackIsKnown) {
  EXPECT_TRUE(is_loopback({"127.0.0.1", 1}));
  EXPECT_TRUE(is_loopback({"localhost", 1}));
  EXPECT_FALSE(is_loopback({"node-1", 1}));
}

class Listener : public testing::Test {
 protected:
  Listener() : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    ::bind(socket_, reinterpret_cast<sockaddr*>(&address), size);
    ::getsockname(socket_, reinterpret_cast<sockaddr*>(&address), &size);
    place_ = {"127.0.0.1", ntohs(address.sin_port)};
  }
  ~Listener() override { ::close(socket_); }

  int socket_;
  Rendezvous place_;
};

TEST_F(Listener, IsAwaited) {
  std::atomic<bool> awaited{false};
  std::thread waiting([&] {
    await_listener(place_, std::chrono::hours(1), nullptr);
    awaited = true;
  });
  EXPECT_FALSE(awaited) << "nobody listens yet";
  ::listen(socket_, 1);
  waiting.join();
  EXPECT_TRUE(awaited);
}

TEST_F(Listener, IsNotAwaitedForEver) {
  EXPECT_THROW(await_listener(place_, std::chrono::seconds(0), nullptr), Error);
  const std::atomic<bool> stop{true};
  EXPECT_THROW(await_listener(place_, std::chrono::hours(1), &stop), Error);
}

}  // namespace
}  // namespace pleat::superres
