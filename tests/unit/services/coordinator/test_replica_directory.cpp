#include "services/coordinator/replica_directory.hpp"

#include <gmock/gmock.h>

#include "common/base/error.hpp"

namespace pleat::coordinator {
namespace {

using std::chrono_literals::operator""ms;
using testing::ElementsAre;
using testing::IsEmpty;

/// A resolver that says what it was told, and counts how often it was asked.
class Names {
 public:
  void set(std::vector<std::string> addresses) {
    const std::lock_guard lock(mutex_);
    addresses_ = std::move(addresses);
  }
  ReplicaDirectory::Resolve resolver() {
    return [this](const std::string& host, const std::string& port) {
      const std::lock_guard lock(mutex_);
      ++asked_[host + " " + port];
      changed_.notify_all();
      if (addresses_.empty()) throw Error(ErrorCode::kUnavailable, "no such name");
      return addresses_;
    };
  }
  /// Until the name was looked up so often from now on.
  void wait_for(const std::string& name, int more) {
    std::unique_lock lock(mutex_);
    const int wanted = asked_[name] + more;
    changed_.wait(lock, [&] { return asked_[name] >= wanted; });
  }
  int asked() {
    const std::lock_guard lock(mutex_);
    int sum = 0;
    for (const auto& [name, times] : asked_) sum += times;
    return sum;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> addresses_;
  std::map<std::string, int> asked_;
};

TEST(ReplicaDirectory, WhatIsNoNameOfReplicasIsItself) {
  Names names;
  ReplicaDirectory directory(1ms, names.resolver());
  const std::vector<std::string> plain = {
      "unix:/run/a", "127.0.0.1:1", "superres:1", "dns:///localhost:1", "dns:///[fd00::1]:50051", "dns:///x"};
  EXPECT_EQ(directory.behind(plain), plain);
  EXPECT_EQ(names.asked(), 0);
  EXPECT_EQ(replicas_behind(nullptr, {"dns:///superres:1"}), std::vector<std::string>{"dns:///superres:1"});
}

TEST(ReplicaDirectory, ANameIsAllItsAddresses) {
  Names names;
  names.set({"10.0.0.1:50053", "10.0.0.2:50053"});
  ReplicaDirectory directory(std::chrono::hours(1), names.resolver());
  EXPECT_THAT(directory.behind({"unix:/a", "dns:///superres:50053"}),
              ElementsAre("unix:/a", "10.0.0.1:50053", "10.0.0.2:50053"));
  EXPECT_EQ(directory.name_of("10.0.0.2:50053"), "superres");
  EXPECT_THAT(directory.name_of("unix:/a"), IsEmpty());
  const std::uint64_t version = directory.version();
  directory.behind({"dns:///superres:50053"});
  EXPECT_EQ(names.asked(), 1) << "who asks again does not wait for a resolver";
  EXPECT_EQ(directory.version(), version);
}

TEST(ReplicaDirectory, ReplicasComeAndGoButNeverAll) {
  Names names;
  ReplicaDirectory directory(1ms, names.resolver());
  const std::vector<std::string> configured = {"dns:///fold:1"};
  EXPECT_EQ(directory.behind(configured), configured) << "gRPC says what is wrong with it";
  names.set({"10.0.0.1:1"});
  names.wait_for("fold 1", 2);
  EXPECT_THAT(directory.behind(configured), ElementsAre("10.0.0.1:1"));
  const std::uint64_t version = directory.version();
  names.wait_for("fold 1", 2);
  EXPECT_EQ(directory.version(), version) << "nothing has changed";
  names.set({"10.0.0.2:1", "10.0.0.3:1"});
  names.wait_for("fold 1", 2);
  EXPECT_THAT(directory.behind(configured), ElementsAre("10.0.0.2:1", "10.0.0.3:1"));
  EXPECT_NE(directory.version(), version);
  names.set({});
  names.wait_for("fold 1", 2);
  EXPECT_THAT(directory.behind(configured), ElementsAre("10.0.0.2:1", "10.0.0.3:1"));
}

TEST(ReplicaDirectory, HostsAreResolvedOnceForEachAddress) {
  EXPECT_THAT(resolve_host("127.0.0.1", "50053"), ElementsAre("127.0.0.1:50053"));
  EXPECT_THAT(resolve_host("::1", "50053"), ElementsAre("[::1]:50053"));
  EXPECT_THROW(resolve_host("no-such-host.invalid", "1"), Error);
}

}  // namespace
}  // namespace pleat::coordinator
