// Streams, server side, that blocking code can use and still end at any time with a status. (The synchronous API can't:
// a handler that waits for the client's next message, or for it to read, can't return, and holds one of gRPC's
// threads.)
#pragma once

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>

#include "common/rpc/end_mark.hpp"
#include "common/rpc/shared_frames.hpp"
#include "common/rpc/stream.hpp"

namespace pleat::coordinator {

/// What streams to a client have in common; Base is grpc::ServerBidiReactor or grpc::ServerWriteReactor. Reactions only
/// set flags: they run on gRPC's few threads and must not wait. One thread at a time writes.
/// Nothing waits longer than the time-outs for the client. A write that it does not take may complete when its
/// connection ends, long after its user has gone: gRPC has serialised the message by then and owns the reactor.
template <typename Base, typename Response>
class BlockingWrites : public Base {
 public:
  using Duration = std::chrono::milliseconds;

  /// gone: called when the client has gone, at once if it has already, in a thread of gRPC's; must not block. It may be
  /// called after finish().
  void on_gone(std::function<void()> gone) {
    std::unique_lock lock(mutex_);
    on_gone_ = std::move(gone);
    const auto call = gone_ ? on_gone_ : nullptr;
    lock.unlock();
    if (call) call();
  }

  /// Waits until the message is sent. False: the client has gone, or has not taken it within `timeout` (after
  /// interrupt(): a second) and is cut off.
  bool write(const Response& response, Duration timeout) {
    std::unique_lock lock(mutex_);
    if (gone_) return false;
    if (sharing_ && shared_->send(response)) return true;
    sharing_ = shared_ != nullptr;
    writing_ = true;
    lock.unlock();
    this->StartWrite(&response);
    lock.lock();
    changed_.wait_for(lock, timeout, [this] { return !writing_ || gone_ || interrupted_; });
    if (interrupted_) changed_.wait_for(lock, std::chrono::seconds(1), [this] { return !writing_ || gone_; });
    if (writing_ && !gone_) {
      timed_out_ = timed_out_ || !interrupted_;
      gone_ = true;
      lock.unlock();
      context_->TryCancel();
      return false;
    }
    return !gone_;
  }

  /// Whether the client was too slow for a read or a write.
  bool timed_out() const {
    const std::lock_guard lock(mutex_);
    return timed_out_;
  }
  bool gone() const {
    const std::lock_guard lock(mutex_);
    return gone_;
  }

  /// What follows the next write goes through shared memory, both ways, if the client offers it for this window. What
  /// lies there has no write that waits: reads look whether it is taken within `reader_timeout`.
  void share_memory(std::uint32_t window, Duration reader_timeout) {
    auto shared = rpc::accept_shared_frames(*context_, window);
    const std::lock_guard lock(mutex_);
    shared_ = std::move(shared);
    reader_timeout_ = reader_timeout;
  }

  /// Whether a read has ended because the client did not take what lies in the shared memory.
  bool left_untaken() const {
    const std::lock_guard lock(mutex_);
    return left_untaken_;
  }

  /// Nothing waits for the client any more. From any thread.
  void interrupt() {
    const std::lock_guard lock(mutex_);
    interrupted_ = true;
    notify();
  }

  /// Ends the stream; last call, when nobody writes any more. Waits a moment until nothing of it is left.
  void finish(const grpc::Status& status) {
    this->Finish(status);
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, std::chrono::seconds(1), [this] { return done_; });
  }

  /// The same without waiting, for a stream that is refused.
  void refuse(const grpc::Status& status) { this->Finish(status); }

 protected:
  explicit BlockingWrites(grpc::CallbackServerContext* context) : context_(context) {}

  /// Until gRPC is done with it.
  template <typename Reactor>
  static std::shared_ptr<Reactor> keep(Reactor* reactor) {
    std::shared_ptr<Reactor> kept(reactor);
    kept->self_ = kept;
    return kept;
  }

  /// With the lock.
  void notify() {
    changed_.notify_all();
    if (shared_) shared_->ring();
  }

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::unique_ptr<rpc::SharedFrames> shared_;
  Duration reader_timeout_{};
  bool sharing_ = false;
  bool interrupted_ = false, timed_out_ = false, left_untaken_ = false;

 private:
  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    writing_ = false;
    gone_ = gone_ || !ok;
    changed_.notify_all();
  }
  void OnCancel() override {
    std::unique_lock lock(mutex_);
    gone_ = true;
    notify();
    const auto call = on_gone_;
    lock.unlock();
    if (call) call();
  }
  void OnDone() override {
    const std::shared_ptr<void> last = std::move(self_);
    const std::lock_guard lock(mutex_);
    done_ = true;
    changed_.notify_all();
  }

  grpc::CallbackServerContext* const context_;
  std::function<void()> on_gone_;
  bool writing_ = false, gone_ = false, done_ = false;
  std::shared_ptr<void> self_;
};

/// A stream to the client.
template <typename Response>
class BlockingWriter final : public BlockingWrites<grpc::ServerWriteReactor<Response>, Response> {
 public:
  static std::shared_ptr<BlockingWriter> make(grpc::CallbackServerContext* context) {
    return BlockingWriter::keep(new BlockingWriter(context));
  }

 private:
  explicit BlockingWriter(grpc::CallbackServerContext* context)
      : BlockingWrites<grpc::ServerWriteReactor<Response>, Response>(context) {}
};

/// A stream in both directions. One thread reads, one at a time writes.
template <typename Request, typename Response>
class BlockingReactor final : public BlockingWrites<grpc::ServerBidiReactor<Request, Response>, Response> {
 public:
  using typename BlockingWrites<grpc::ServerBidiReactor<Request, Response>, Response>::Duration;

  static std::shared_ptr<BlockingReactor> make(grpc::CallbackServerContext* context) {
    return BlockingReactor::keep(new BlockingReactor(context));
  }

  /// The next message, valid until the next call; null when the client has no more, has gone, sent nothing within
  /// `timeout`, sent bytes that are no message, or after interrupt().
  const Request* read(Duration timeout) {
    std::unique_lock lock(this->mutex_);
    if (this->interrupted_ || ended_) return nullptr;
    if (this->sharing_) return read_shared(lock, timeout);
    reading_ = true;
    rpc::set_end_mark(&request_);
    lock.unlock();
    this->StartRead(&request_);
    lock.lock();
    if (!this->changed_.wait_for(lock, timeout, [this] { return !reading_ || this->interrupted_; })) {
      this->timed_out_ = true;
    }
    return reading_ || ended_ ? nullptr : &request_;
  }

  /// Whether the last message could not be read.
  bool undecodable() const {
    const std::lock_guard lock(this->mutex_);
    return undecodable_;
  }

 private:
  explicit BlockingReactor(grpc::CallbackServerContext* context)
      : BlockingWrites<grpc::ServerBidiReactor<Request, Response>, Response>(context) {}

  const Request* read_shared(std::unique_lock<std::mutex>& lock, Duration timeout) {
    using Clock = std::chrono::steady_clock;
    const auto deadline = Clock::now() + timeout;
    while (true) {
      const std::uint32_t rings = this->shared_->rings();
      const bool closed = this->shared_->closed();
      if (this->interrupted_) return nullptr;
      if (this->shared_->available()) break;
      const auto now = Clock::now();
      const std::uint32_t taken = this->shared_->taken();
      const bool waits = this->shared_->on_their_way() > 0;
      if (!waits || !waited_ || taken != taken_) taken_at_ = now;
      taken_ = taken;
      waited_ = waits;
      this->left_untaken_ = waits && now >= taken_at_ + this->reader_timeout_;
      this->timed_out_ = this->left_untaken_ || now >= deadline;
      if (closed || this->timed_out_) return nullptr;
      lock.unlock();
      // Nobody rings here when an answer is sent or taken.
      this->shared_->wait(rings, std::min(deadline, taken_at_ + this->reader_timeout_));
      lock.lock();
    }
    lock.unlock();
    const bool parsed = this->shared_->receive(&request_);
    lock.lock();
    undecodable_ = ended_ = !parsed;
    return parsed ? &request_ : nullptr;
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(this->mutex_);
    reading_ = false;
    ended_ = ended_ || !ok;
    undecodable_ = !ok && !rpc::has_end_mark(request_);
    this->changed_.notify_all();
  }

  Request request_;
  bool reading_ = false, ended_ = false, undecodable_ = false;
  bool waited_ = false;      ///< whether answers lay in the shared memory when a read last looked
  std::uint32_t taken_ = 0;  ///< by the client, at that time, and since when it has been so
  std::chrono::steady_clock::time_point taken_at_{};
};

}  // namespace pleat::coordinator
