// Which replicas there are behind a name: all addresses that it resolves to, looked up again and again.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace pleat::coordinator {

/// All addresses of a host, HOST:PORT with numbers, sorted: its IPv4 ones, or if it has none its IPv6 ones, so that no
/// replica is there twice. Throws kUnavailable if it has none. May take the resolver's time-out.
std::vector<std::string> resolve_host(const std::string& host, const std::string& port);

/// What of this coordinator's work lies with a replica, of all its jobs and live sessions.
struct ReplicaLoad {
  std::atomic<int> frames{0};    ///< in flight
  std::atomic<int> sessions{0};  ///< that stay in it: of the simulation, and of stages whose frames follow each other
};

/// One more frame or session, while it lives.
class LoadShare {
 public:
  LoadShare(std::shared_ptr<ReplicaLoad> load, std::atomic<int> ReplicaLoad::*what)
      : load_(std::move(load)), what_(what) {
    if (load_) ++(*load_.*what_);
  }
  ~LoadShare() {
    if (load_) --(*load_.*what_);
  }
  LoadShare(const LoadShare&) = delete;
  LoadShare& operator=(const LoadShare&) = delete;

 private:
  const std::shared_ptr<ReplicaLoad> load_;
  std::atomic<int> ReplicaLoad::*const what_;
};

/// What stands for several replicas is `dns:///NAME:PORT`: a headless service. Other addresses, and localhost, are
/// themselves. A name that does not resolve keeps the replicas that it had, and is itself if it had none. Thread-safe.
class ReplicaDirectory {
 public:
  using Resolve = std::function<std::vector<std::string>(const std::string& host, const std::string& port)>;

  explicit ReplicaDirectory(std::chrono::milliseconds interval = std::chrono::seconds(3),
                            Resolve resolve = &resolve_host);
  ~ReplicaDirectory();
  ReplicaDirectory(const ReplicaDirectory&) = delete;
  ReplicaDirectory& operator=(const ReplicaDirectory&) = delete;

  /// The replicas behind configured addresses, in their order. The first call for a name resolves it.
  std::vector<std::string> behind(const std::vector<std::string>& configured);

  /// Changes whenever an answer of behind() does.
  std::uint64_t version() const { return version_; }
  /// From 0, one more for each call: to begin with another replica than the caller before.
  std::size_t turn() { return turn_++; }
  /// The name that a replica was found behind, for its certificate; empty for other addresses.
  std::string name_of(const std::string& address) const;
  /// The one of this address, whoever asks.
  std::shared_ptr<ReplicaLoad> load_of(const std::string& address);

 private:
  struct Name {
    std::string host, port;
    std::vector<std::string> addresses;
  };

  void look();
  /// With what the name has now, if it has anything.
  void resolve(const std::string& configured, Name name);

  const std::chrono::milliseconds interval_;
  const Resolve resolve_;
  std::atomic<std::uint64_t> version_{1};
  std::atomic<std::size_t> turn_{0};
  mutable std::mutex mutex_;
  std::condition_variable stop_;
  bool stopping_ = false;
  std::map<std::string, Name> names_;           ///< by configured address
  std::map<std::string, std::string> name_of_;  ///< by replica
  std::map<std::string, std::shared_ptr<ReplicaLoad>> loads_;
  std::thread looking_;
};

/// The same without a directory: the addresses themselves.
std::vector<std::string> replicas_behind(const std::shared_ptr<ReplicaDirectory>& directory,
                                         const std::vector<std::string>& configured);

}  // namespace pleat::coordinator
