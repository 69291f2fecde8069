#include "services/superres/kernels/team.hpp"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

namespace pleat::superres::kernels {
namespace {

/// Looks before sleeping: about 20 microseconds.
constexpr int kLooks = 400;

void pause() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

/// Until `value` is no longer `old`.
void wait_for_change(const std::atomic<std::uint32_t>& value, std::uint32_t old) {
  for (int i = 0; i < kLooks; ++i) {
    if (value.load(std::memory_order_acquire) != old) return;
    pause();
  }
  value.wait(old, std::memory_order_acquire);
}

}  // namespace

struct Team::State {
  std::vector<std::thread> threads;
  int members = 1;
  bool alone = false;
  std::atomic<std::uint32_t> task_number{0};
  std::atomic<std::uint32_t> round{0};
  std::atomic<int> arrived{0};
  const std::function<void(int)>* task = nullptr;  ///< null: end
};

Team::Team(int members) : state_(std::make_unique<State>()) {
  state_->members = std::max(1, members);
  for (int member = 1; member < state_->members; ++member) {
    state_->threads.emplace_back([this, member] {
      for (std::uint32_t seen = 0;; ++seen) {
        wait_for_change(state_->task_number, seen);
        if (state_->task == nullptr) return;
        (*state_->task)(member);
        barrier();
      }
    });
  }
}

Team::~Team() {
  state_->task = nullptr;
  state_->task_number.fetch_add(1, std::memory_order_release);
  state_->task_number.notify_all();
  for (auto& thread : state_->threads) thread.join();
}

int Team::members() const { return state_->alone ? 1 : state_->members; }
int Team::largest() const { return state_->members; }

void Team::run(const std::function<void(int)>& task, bool alone) {
  state_->alone = alone;
  if (members() == 1) return task(0);
  state_->task = &task;
  state_->task_number.fetch_add(1, std::memory_order_release);
  state_->task_number.notify_all();
  task(0);
  barrier();
}

void Team::barrier() {
  if (members() == 1) return;
  const std::uint32_t round = state_->round.load(std::memory_order_acquire);
  if (state_->arrived.fetch_add(1, std::memory_order_acq_rel) + 1 == state_->members) {
    state_->arrived.store(0, std::memory_order_relaxed);
    state_->round.fetch_add(1, std::memory_order_release);
    state_->round.notify_all();
    return;
  }
  wait_for_change(state_->round, round);
}

}  // namespace pleat::superres::kernels
