// Loops over index ranges on a fixed set of threads.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

namespace pleat {

/// A fixed set of threads for data-parallel loops. The calling thread takes part.
/// One loop at a time; not to be called from inside a loop body. Not thread-safe: one pool per owner.
class ThreadPool {
 public:
  /// threads: workers including the caller; 0 means the number of processors this process may use.
  explicit ThreadPool(std::size_t threads = 0);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  std::size_t size() const noexcept;

  /// Calls body(begin, end) on disjoint ranges that cover [0, count), each of `grain` indices at most, and waits.
  /// The ranges depend on count and grain only, never on the number of threads, so that sums accumulated per range
  /// and added in range order are bit-identical. The first exception of a body is rethrown.
  void parallel_for(std::size_t count, std::size_t grain,
                    const std::function<void(std::size_t begin, std::size_t end)>& body);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The number of processors this process may run on (affinity and cgroup quota respected), at least 1.
std::size_t available_processors();

}  // namespace pleat
