// A client of a synchronous stream that has gone silent.
#pragma once

#include <grpcpp/server_context.h>

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <thread>

#include "common/base/error.hpp"

namespace pleat::coordinator {

/// Cancels the call when one read takes longer than `patience`: a synchronous read can't be given a time.
class SilenceWatch {
 public:
  SilenceWatch(grpc::ServerContext& context, std::chrono::milliseconds patience)
      : context_(context), patience_(patience), thread_([this] { watch(); }) {}
  ~SilenceWatch() {
    {
      const std::lock_guard lock(mutex_);
      over_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  SilenceWatch(const SilenceWatch&) = delete;
  SilenceWatch& operator=(const SilenceWatch&) = delete;

  /// What `read` returns. Throws kDeadlineExceeded if it took too long.
  template <typename Read>
  bool during(const Read& read) {
    mark(true);
    const bool result = read();
    mark(false);
    const std::lock_guard lock(mutex_);
    if (cancelled_) throw Error(ErrorCode::kDeadlineExceeded, "the client sends nothing");
    return result;
  }

 private:
  void mark(bool reading) {
    {
      const std::lock_guard lock(mutex_);
      reading_ = reading;
      since_ = std::chrono::steady_clock::now();
    }
    changed_.notify_all();
  }
  void watch() {
    std::unique_lock lock(mutex_);
    while (!over_) {
      if (!reading_) {
        changed_.wait(lock);
      } else if (std::chrono::steady_clock::now() < since_ + patience_) {
        changed_.wait_until(lock, since_ + patience_);
      } else {
        cancelled_ = true;
        context_.TryCancel();
        return;
      }
    }
  }

  grpc::ServerContext& context_;
  const std::chrono::milliseconds patience_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool reading_ = false, cancelled_ = false, over_ = false;
  std::chrono::steady_clock::time_point since_;
  std::thread thread_;  // the last member: it uses the others
};

}  // namespace pleat::coordinator
