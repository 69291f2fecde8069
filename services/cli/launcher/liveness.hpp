// Which of several services on this host have stopped answering.
#pragma once

#include <grpcpp/channel.h>

#include <chrono>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

namespace pleat::cli {

/// Asks every watched service for its health once a second, in a thread of its own. Thread-safe.
class Liveness {
 public:
  using Duration = std::chrono::milliseconds;

  /// patience: a service that has answered before hangs when it has not for this long.
  explicit Liveness(Duration patience);
  ~Liveness();
  Liveness(const Liveness&) = delete;
  Liveness& operator=(const Liveness&) = delete;

  /// Watches `service` ("pleat.v1.Refinement") at `address`, in place of what had this key before. Until its first
  /// answer it may take as long as `start`.
  void watch(const std::string& key, const std::string& service, const std::string& address, Duration start);
  void forget(const std::string& key);

  /// Whether the service with this key has been silent for too long. One that is not watched is not.
  bool hangs(const std::string& key) const;

 private:
  using Clock = std::chrono::steady_clock;
  struct Watched {
    std::string service;
    std::shared_ptr<grpc::Channel> channel;
    Clock::time_point deadline;  ///< of its next answer
  };

  void run();

  const Duration patience_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::map<std::string, Watched> watched_;
  bool over_ = false;
  std::thread thread_;
};

}  // namespace pleat::cli
