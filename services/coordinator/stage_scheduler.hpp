// Which frame goes to which replica of a stage, what is sent again after a fault, and when a frame goes on: the part of
// a stage that knows no network.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace pleat::coordinator {

struct StageLimits {
  std::size_t replicas = 1;
  std::size_t window = 4;  ///< frames in flight per replica
  int strikes = 5;  ///< a frame that was the oldest in flight this many times when a replica broke off is given up
};

/// Item needs `std::uint64_t sequence` and `std::shared_ptr<const Work> work` (what is sent; constant while in flight).
///
/// Items enter in sequence, without gaps, and leave in sequence. At most replicas in use * window are inside, so that
/// memory is bounded and a slow consumer slows the producer. Thread-safe; each replica has one sender and one receiver
/// thread. The sender is woken up only for what waits: who pushes an item that a replica can take at once sends it
/// itself.
template <typename Item>
class StageScheduler {
 public:
  using ItemPtr = std::unique_ptr<Item>;
  using Work = decltype(Item::work);
  using Clock = std::chrono::steady_clock;
  /// Takes an item that is done; called by one thread at a time, in sequence; may block.
  using Deliver = std::function<void(ItemPtr)>;

  /// drained: called once when the stage is closed and everything was delivered.
  StageScheduler(StageLimits limits, std::uint64_t first_sequence, Deliver deliver, std::function<void()> drained)
      : limits_(limits),
        next_(first_sequence),
        deliver_(std::move(deliver)),
        on_drained_(std::move(drained)),
        replicas_(limits.replicas),
        used_(limits.replicas) {}

  /// Work for its caller to send, followed by sent(replica). Without work: nothing to do.
  struct Direct {
    Work work = nullptr;
    std::size_t replica = 0;
  };

  /// Waits for room. Returns false, and drops the item, when the stage was stopped.
  bool push(ItemPtr item, Direct* direct = nullptr) {
    {
      std::unique_lock lock(mutex_);
      if (!wait_for_room(lock)) return false;
      const std::uint64_t sequence = item->sequence;
      const bool first = pending_.empty();
      pending_.emplace(sequence, Entry{std::move(item)});
      if (direct != nullptr && first) {
        const std::size_t r = chosen();
        if (r != kNone && !replicas_[r].sender_sends) {
          *direct = {take_next(r), r};
          replicas_[r].other_sends = true;
          return true;
        }
      }
    }
    changed_.notify_all();
    return true;
  }

  /// What push() returned as `direct` is sent.
  void sent(std::size_t replica) {
    bool awaited = false;
    {
      const std::lock_guard lock(mutex_);
      replicas_[replica].other_sends = false;
      awaited = !pending_.empty() || !replicas_[replica].live || replicas_[replica].leaving;
    }
    if (awaited) changed_.notify_all();
  }

  /// Waits until nobody sends to a replica that is not connected any more.
  void wait_sent(std::size_t replica) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return !replicas_[replica].other_sends; });
  }

  /// The same for an item that this stage has nothing to do for (it failed before): it only keeps its place.
  bool pass(ItemPtr item) {
    {
      std::unique_lock lock(mutex_);
      if (!wait_for_room(lock)) return false;
    }
    complete(std::move(item));
    return true;
  }

  /// No more items will come.
  void close() {
    std::unique_lock lock(mutex_);
    closed_ = true;
    finish_if_drained(lock);
  }

  /// Drops everything; all waiting calls return.
  void stop() {
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    changed_.notify_all();
    room_.notify_all();
  }

  /// True when stopped or drained: replicas need not be connected any more.
  bool finished() const {
    const std::lock_guard lock(mutex_);
    return stopped_ || drained_;
  }
  bool drained() const {
    const std::lock_guard lock(mutex_);
    return drained_;
  }

  /// Sleeps between attempts; returns early, and true, when finished.
  bool wait_finished(std::chrono::milliseconds time) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, time, [this] { return stopped_ || drained_; });
  }

  /// Items in flight at a replica, of everybody who sends to it.
  using Load = std::shared_ptr<const std::atomic<int>>;

  /// A replica can take work from now on. load: null where nobody else sends to it.
  void connected(std::size_t replica, Load load = nullptr) {
    {
      const std::lock_guard lock(mutex_);
      replicas_[replica].live = true;
      replicas_[replica].load = std::move(load);
    }
    changed_.notify_all();
  }

  /// Whether the replica is one: all are at first. Room is what those in use have; one that is not must not be live.
  void use(std::size_t replica, bool used) {
    {
      const std::lock_guard lock(mutex_);
      Replica& changed = replicas_[replica];
      if (changed.used != used) used_ += used ? 1 : -1;
      changed.used = used;
      changed.leaving = false;
    }
    changed_.notify_all();
    room_.notify_all();
  }

  /// The replica gets no more work: take() returns null once what it has is answered.
  void leave(std::size_t replica) {
    {
      const std::lock_guard lock(mutex_);
      replicas_[replica].leaving = true;
    }
    changed_.notify_all();
  }

  /// Its receiver has ended: take() returns. broke_off() follows.
  void disconnected(std::size_t replica) {
    {
      const std::lock_guard lock(mutex_);
      replicas_[replica].live = false;
    }
    changed_.notify_all();
  }

  std::size_t live() const {
    const std::lock_guard lock(mutex_);
    std::size_t count = 0;
    for (const Replica& replica : replicas_) count += replica.live ? 1 : 0;
    return count;
  }

  bool live(std::size_t replica) const {
    const std::lock_guard lock(mutex_);
    return replicas_[replica].live;
  }

  /// The next work for a replica; waits until it has room, is the one with the least load, and work is there.
  /// Null when the stage is finished, or the replica is not connected or has left. What was taken before is sent.
  Work take(std::size_t replica) {
    std::unique_lock lock(mutex_);
    Replica& taker = replicas_[replica];
    taker.sender_sends = false;
    changed_.wait(lock, [&] { return ended(taker) || (!pending_.empty() && is_chosen(replica)); });
    if (ended(taker)) return nullptr;
    Work work = take_next(replica);
    taker.sender_sends = true;
    if (!pending_.empty()) {
      lock.unlock();
      changed_.notify_all();
    }
    return work;
  }

  /// A replica answered. Null if it has no such work: the replica breaks the contract, or the answer is a late one.
  /// On success `round_trip` has the time since the work was taken.
  ItemPtr answered(std::size_t replica, std::uint64_t sequence, std::chrono::duration<double>& round_trip) {
    ItemPtr item;
    bool awaited = false;
    {
      const std::lock_guard lock(mutex_);
      Replica& from = replicas_[replica];
      const auto found = from.outstanding.find(sequence);
      if (found == from.outstanding.end()) return nullptr;
      round_trip = Clock::now() - found->second.sent;
      item = std::move(found->second.item);
      from.outstanding.erase(found);
      awaited = !pending_.empty() || from.leaving;
    }
    if (awaited) changed_.notify_all();
    return item;
  }

  /// Hands an item on as soon as all before it were. May block in the consumer.
  void complete(ItemPtr item) {
    std::unique_lock lock(mutex_);
    const std::uint64_t sequence = item->sequence;
    ready_.emplace(sequence, std::move(item));
    if (delivering_) return;
    delivering_ = true;
    while (!stopped_ && !ready_.empty() && ready_.begin()->first == next_) {
      ItemPtr next = std::move(ready_.begin()->second);
      ready_.erase(ready_.begin());
      lock.unlock();
      deliver_(std::move(next));
      lock.lock();
      ++next_;
      --inside_;
      room_.notify_one();
    }
    delivering_ = false;
    finish_if_drained(lock);
  }

  /// A replica broke off: what it had goes back, to be taken first. Returns the oldest item if it has used up its
  /// strikes; the caller completes it with an error.
  ItemPtr broke_off(std::size_t replica) {
    ItemPtr given_up;
    {
      const std::lock_guard lock(mutex_);
      Replica& broken = replicas_[replica];
      broken.live = false;
      if (!broken.outstanding.empty()) {
        const auto oldest = broken.outstanding.begin();
        if (++oldest->second.strikes >= limits_.strikes) {
          given_up = std::move(oldest->second.item);
          broken.outstanding.erase(oldest);
        }
      }
      pending_.merge(broken.outstanding);
      broken.outstanding.clear();
    }
    changed_.notify_all();
    return given_up;
  }

  std::size_t inside() const {
    const std::lock_guard lock(mutex_);
    return inside_;
  }

 private:
  struct Entry {
    ItemPtr item;
    int strikes = 0;
    Clock::time_point sent{};
  };
  struct Replica {
    bool live = false;
    bool used = true, leaving = false;
    bool sender_sends = false;  ///< what take() returned
    bool other_sends = false;   ///< what push() returned
    std::map<std::uint64_t, Entry> outstanding;
    Load load;
  };

  bool wait_for_room(std::unique_lock<std::mutex>& lock) {
    room_.wait(lock, [this] { return stopped_ || inside_ < std::max<std::size_t>(1, used_) * limits_.window; });
    if (stopped_) return false;
    ++inside_;
    return true;
  }

  bool ended(const Replica& replica) const {
    return stopped_ || drained_ || !replica.live ||
           (replica.leaving && replica.outstanding.empty() && !replica.other_sends);
  }

  static constexpr std::size_t kNone = ~std::size_t{0};

  /// Whether it has room, and nobody sends to it in its sender's place.
  bool may_take(const Replica& replica) const {
    return replica.live && !replica.leaving && !replica.other_sends && replica.outstanding.size() < limits_.window;
  }

  /// Of those that may take, the replica with the least in flight; one whose sender sends only where no other waits,
  /// because nobody knows how long that takes. A choice stays until an item is taken: the load changes at any time, and
  /// all senders have to agree on who goes.
  std::size_t chosen() {
    if (chosen_ != kNone && may_take(replicas_[chosen_]) && !replicas_[chosen_].sender_sends) return chosen_;
    chosen_ = kNone;
    std::pair<bool, int> least;
    for (std::size_t r = 0; r < replicas_.size(); ++r) {
      const Replica& replica = replicas_[r];
      if (!may_take(replica)) continue;
      // What was taken last may not be counted yet.
      const int mine = static_cast<int>(replica.outstanding.size()), all = replica.load ? replica.load->load() : 0;
      const std::pair rank{replica.sender_sends, std::max(mine, all)};
      if (chosen_ != kNone && !(rank < least)) continue;
      chosen_ = r;
      least = rank;
    }
    return chosen_;
  }

  /// For a sender that waits; the one that was chosen may wait, too.
  bool is_chosen(std::size_t replica) {
    const std::size_t before = chosen_, now = chosen();
    if (now != before && now != replica) changed_.notify_all();
    return now == replica;
  }

  Work take_next(std::size_t replica) {
    auto node = pending_.extract(pending_.begin());
    node.mapped().sent = Clock::now();
    Work work = node.mapped().item->work;
    replicas_[replica].outstanding.insert(std::move(node));
    chosen_ = kNone;
    return work;
  }

  void finish_if_drained(std::unique_lock<std::mutex>& lock) {
    if (!closed_ || drained_ || stopped_ || inside_ != 0) return;
    drained_ = true;
    lock.unlock();
    changed_.notify_all();
    on_drained_();
  }

  const StageLimits limits_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::condition_variable room_;
  std::uint64_t next_;
  const Deliver deliver_;
  const std::function<void()> on_drained_;
  std::vector<Replica> replicas_;
  std::size_t used_;
  std::size_t chosen_ = kNone;  ///< for the next item
  std::map<std::uint64_t, Entry> pending_;
  std::map<std::uint64_t, ItemPtr> ready_;
  std::size_t inside_ = 0;
  bool delivering_ = false, closed_ = false, drained_ = false, stopped_ = false;
};

}  // namespace pleat::coordinator
