// A few threads that work on one small task together and meet at barriers.
#pragma once

#include <functional>
#include <memory>

namespace pleat::superres::kernels {

/// ThreadPool is for loops of milliseconds; here a loop takes tens of microseconds, so that members who wait look for
/// the others a while before they sleep. They do sleep, in short: other work on the same processors goes on.
class Team {
 public:
  /// members: including the calling thread, at least 1.
  explicit Team(int members);
  ~Team();
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  /// Of the task at hand: all, or 1 while it runs alone.
  int members() const;
  int largest() const;

  /// Calls task(member) for every member, member 0 on the calling thread, and waits. The task may call barrier() but
  /// must not throw. alone: member 0 does everything, and nobody is woken.
  void run(const std::function<void(int member)>& task, bool alone = false);

  /// Returns when every member has called it.
  void barrier();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::kernels
