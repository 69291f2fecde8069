// What those who watch a live session see of it.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <utility>

#include "services/coordinator/job.hpp"
#include "services/coordinator/result_events.hpp"

namespace pleat::coordinator {

/// How far a session is, and its newest frame while somebody watches. Nothing waits for a watcher. Thread-safe.
class SessionFeed {
 public:
  explicit SessionFeed(JobRecord record) : record_(std::move(record)) {}

  JobRecord record() const {
    const std::lock_guard lock(mutex_);
    return record_;
  }

  void update(const std::function<void(JobRecord&)>& change) {
    {
      const std::lock_guard lock(mutex_);
      change(record_);
      ++revision_;
    }
    changed_.notify_all();
  }

  /// While it lives, `make` gives the event that frames refer to; it is called once, when the first watcher asks.
  class Opened {
   public:
    Opened(SessionFeed& feed, std::function<EventPtr()> make) : feed_(feed) {
      const std::lock_guard lock(feed_.mutex_);
      feed_.make_opened_ = std::move(make);
    }
    ~Opened() {
      const std::lock_guard lock(feed_.mutex_);
      feed_.make_opened_ = nullptr;
    }
    Opened(const Opened&) = delete;
    Opened& operator=(const Opened&) = delete;

   private:
    SessionFeed& feed_;
  };

  /// While it lives, somebody watches.
  class Watch {
   public:
    explicit Watch(SessionFeed& feed) : feed_(feed) { feed_.count(1); }
    ~Watch() { feed_.count(-1); }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

   private:
    SessionFeed& feed_;
  };

  bool is_watched() const {
    const std::lock_guard lock(mutex_);
    return watchers_ > 0;
  }

  void publish(EventPtr frame) {
    {
      const std::lock_guard lock(mutex_);
      frame_ = std::move(frame);
      ++frame_revision_;
      ++revision_;
    }
    changed_.notify_all();
  }

  struct News {
    std::uint64_t revision = 0;  ///< of the record
    JobRecord record;
    EventPtr opened;  ///< null before the session is open, and after its end where nobody had asked
    std::uint64_t frame_revision = 0;
    EventPtr frame;  ///< null before the first
  };
  /// Waits until there is more than at `revision`, or the time is over.
  News wait(std::uint64_t revision, std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return revision_ > revision; });
    if (!opened_ && make_opened_) opened_ = make_opened_();
    return {revision_, record_, opened_, frame_revision_, frame_};
  }

 private:
  void count(int change) {
    const std::lock_guard lock(mutex_);
    watchers_ += change;
    if (watchers_ == 0) frame_ = nullptr;
  }

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  JobRecord record_;
  std::uint64_t revision_ = 1, frame_revision_ = 0;
  std::function<EventPtr()> make_opened_;
  EventPtr opened_, frame_;
  int watchers_ = 0;
};

}  // namespace pleat::coordinator
