// Processes that make sequences, one each, and what they tell of it.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "services/dataset/sequence.hpp"

namespace pleat::dataset {

struct WorkerEvent {
  enum class Kind : std::uint32_t { kFrame, kDone, kDropped, kInterrupted, kFailed };
  Kind kind = Kind::kFrame;
  std::size_t plan = 0;        ///< as given to start()
  std::uint64_t frames = 0;    ///< kFrame: complete ones of the sequence
  std::string text;            ///< kDone: the figures; kDropped, kFailed: why
  std::optional<Error> error;  ///< kFailed; also if the process died without a word
};

/// Each process says how it ended, once, and is gone when size() no longer counts it. They die with the pool, and with
/// the thread that made it. Not thread-safe. Forks: use it before other threads exist.
class WorkerPool {
 public:
  /// What a process does; `on_frame` and `stopped` are those of make_sequence.
  using Job = std::function<SequenceReport(const std::function<void(std::uint64_t)>& on_frame,
                                           const std::function<bool()>& stopped)>;
  enum class Signals {
    kAsGiven,  ///< the processes react as this one does
    kIgnored,  ///< SIGINT, SIGTERM and SIGHUP, which batch systems send to all processes, don't reach them: stop() does
  };

  explicit WorkerPool(Signals signals = Signals::kAsGiven);
  /// Kills what still runs.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// Throws kResourceExhausted (no process, no pipe).
  void start(std::size_t plan, const Job& job);
  std::size_t size() const { return workers_.size(); }

  /// Waits for news, at most for `timeout` (negative: for ever) or until a signal arrives, and hands them on.
  void wait(std::chrono::milliseconds timeout, const std::function<void(const WorkerEvent&)>& on_event);

  /// From now on `stopped` says yes, in all processes.
  void stop();
  /// Ends the process that makes `plan` at once, and without a word of it.
  void kill(std::size_t plan);

 private:
  struct Worker {
    std::size_t plan = 0;
    pid_t process = -1;
    int pipe = -1;
    bool ended = false;  ///< it said how
  };
  struct Flag;

  [[noreturn]] void run(const Job& job, int pipe, pid_t parent) const;
  std::optional<WorkerEvent> read_event(Worker& worker);

  Signals signals_;
  Flag* stopped_;  ///< in memory that the processes share
  std::vector<Worker> workers_;
};

}  // namespace pleat::dataset
