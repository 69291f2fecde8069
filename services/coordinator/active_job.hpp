// A job that is being worked on, and how others end it.
#pragma once

#include <functional>
#include <list>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "services/coordinator/job_feed.hpp"

namespace pleat::coordinator {

/// A job that is being worked on, as far as others may touch it.
class ActiveJob {
 public:
  explicit ActiveJob(std::string job_id) : id(std::move(job_id)) {}

  const std::string id;
  JobFeed feed;

  /// Ends the work soon; the first cause counts. From any thread.
  void abort(const Error& cause);
  std::optional<Error> cause() const;

  /// While it lives, abort() calls `interrupt` (at once if it was called before).
  class Interrupt {
   public:
    Interrupt(ActiveJob& job, std::function<void(const Error&)> interrupt);
    ~Interrupt();
    Interrupt(const Interrupt&) = delete;
    Interrupt& operator=(const Interrupt&) = delete;

   private:
    ActiveJob& job_;
    std::list<std::function<void(const Error&)>>::iterator place_;
  };

 private:
  mutable std::mutex mutex_;
  std::optional<Error> cause_;
  std::list<std::function<void(const Error&)>> interrupts_;
};

}  // namespace pleat::coordinator
