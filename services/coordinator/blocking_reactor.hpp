// A bidirectional stream, server side, that blocking code can use and still end at any time with a status. (The
// synchronous API can't: a handler that waits for the client's next message can't return.)
#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>

namespace pleat::coordinator {

/// Reactions only set flags: they run on gRPC's few threads and must not wait. One thread reads, one at a time writes.
template <typename Request, typename Response>
class BlockingReactor final : public grpc::ServerBidiReactor<Request, Response> {
 public:
  /// gone: called once when the client has gone, in a thread of gRPC's; must not block.
  static std::shared_ptr<BlockingReactor> make(grpc::CallbackServerContext* context, std::function<void()> gone = {}) {
    std::shared_ptr<BlockingReactor> reactor(new BlockingReactor(context, std::move(gone)));
    reactor->self_ = reactor;  // until OnDone
    return reactor;
  }

  /// The next message, valid until the next call; null when the client has no more, has gone, or after interrupt().
  const Request* read() {
    std::unique_lock lock(mutex_);
    if (interrupted_ || ended_) return nullptr;
    reading_ = true;
    lock.unlock();
    this->StartRead(&request_);
    lock.lock();
    changed_.wait(lock, [this] { return !reading_ || interrupted_; });
    return reading_ || ended_ ? nullptr : &request_;
  }

  /// Waits until the message is sent. False: the client has gone. After interrupt() a client that does not read has a
  /// second before it is cut off.
  bool write(const Response& response) {
    std::unique_lock lock(mutex_);
    if (gone_) return false;
    writing_ = true;
    lock.unlock();
    this->StartWrite(&response);
    lock.lock();
    changed_.wait(lock, [this] { return !writing_ || interrupted_; });
    if (!changed_.wait_for(lock, std::chrono::seconds(1), [this] { return !writing_; })) {
      context_->TryCancel();
      changed_.wait(lock, [this] { return !writing_; });
    }
    return !gone_;
  }

  /// read() returns null from now on. From any thread.
  void interrupt() {
    const std::lock_guard lock(mutex_);
    interrupted_ = true;
    changed_.notify_all();
  }

  /// Ends the stream; last call, when nobody writes any more. Waits until nothing of it is left.
  void finish(const grpc::Status& status) {
    this->Finish(status);
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return done_; });
  }

  /// The same without waiting, for a stream that is refused.
  void refuse(const grpc::Status& status) { this->Finish(status); }

 private:
  BlockingReactor(grpc::CallbackServerContext* context, std::function<void()> gone)
      : context_(context), on_gone_(std::move(gone)) {}

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    reading_ = false;
    ended_ = ended_ || !ok;
    changed_.notify_all();
  }
  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    writing_ = false;
    gone_ = gone_ || !ok;
    changed_.notify_all();
  }
  void OnCancel() override {
    {
      const std::lock_guard lock(mutex_);
      gone_ = true;
      changed_.notify_all();
    }
    if (on_gone_) on_gone_();
  }
  void OnDone() override {
    const std::shared_ptr<BlockingReactor> last = std::move(self_);
    const std::lock_guard lock(mutex_);
    done_ = true;
    changed_.notify_all();
  }

  grpc::CallbackServerContext* const context_;
  const std::function<void()> on_gone_;
  std::mutex mutex_;
  std::condition_variable changed_;
  Request request_;
  bool reading_ = false, writing_ = false, ended_ = false, gone_ = false, interrupted_ = false, done_ = false;
  std::shared_ptr<BlockingReactor> self_;
};

}  // namespace pleat::coordinator
