// A service that stops: it opens no more streams, and those that it has end once what it has read is answered.
#pragma once

#include <atomic>
#include <functional>
#include <list>
#include <mutex>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::rpc {

/// Thread-safe. It outlives the streams that look at it.
class Drain {
 public:
  /// Wakes up every stream. To be given to run_server() as the service's `drain`.
  void begin() {
    const std::lock_guard lock(mutex_);
    begun_ = true;
    for (const auto& wake : wakes_) wake();
  }
  bool begun() const { return begun_; }
  /// For what begins. Throws kUnavailable: another replica takes it.
  void require_none() const {
    if (begun_) throw Error(ErrorCode::kUnavailable, kCause);
  }
  static constexpr const char* kCause = "the service is stopping";

  /// While it lives, begin() calls `wake`, which must not block; at once if it has begun.
  class Watch {
   public:
    /// drain: null for none.
    Watch(Drain* drain, std::function<void()> wake) : drain_(drain) {
      if (drain_ == nullptr) return;
      const std::lock_guard lock(drain_->mutex_);
      if (drain_->begun_) wake();
      place_ = drain_->wakes_.insert(drain_->wakes_.end(), std::move(wake));
    }
    ~Watch() {
      if (drain_ == nullptr) return;
      const std::lock_guard lock(drain_->mutex_);
      drain_->wakes_.erase(place_);
    }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

   private:
    Drain* const drain_;
    std::list<std::function<void()>>::iterator place_;
  };

 private:
  std::mutex mutex_;
  std::atomic<bool> begun_{false};
  std::list<std::function<void()>> wakes_;
};

}  // namespace pleat::rpc
