// Implementation of stream.hpp's templates: the client's side.
#pragma once

namespace pleat::rpc {

/// The call as gRPC sees it. It keeps itself alive until gRPC is done with it.
template <typename Request, typename Response>
class FrameStream<Request, Response>::Call final : public Reactor {
 public:
  /// offered: null for none.
  static std::shared_ptr<Call> start(const Starter& start, std::unique_ptr<SharedFrames> offered) {
    auto call = std::make_shared<Call>();
    call->self_ = call;
    if (offered) call->context_.AddMetadata(SharedFrames::kKey, offered->ticket());
    call->shared = std::move(offered);
    start(&call->context_, call.get());
    call->AddHold();
    call->StartCall();
    return call;
  }

  /// All with the lock, which they give up while gRPC works. gRPC serialises a request before StartWrite returns, and
  /// an answer comes into `response`: an abandoned call touches nothing of its user's.
  void start_read(Lock& lock) {
    reading = true;
    set_end_mark(&response);
    outside(lock, [&] { this->StartRead(&response); });
  }
  void start_write(Lock& lock, const Request& request) {
    writing = true;
    outside(lock, [&] { this->StartWrite(&request); });
  }
  void start_writes_done(Lock& lock) {
    outside(lock, [&] { this->StartWritesDone(); });
  }
  /// After the first answer: the frames go through shared memory if the peer has taken it up. The call tells then when
  /// the stream ends, by a read that finds nothing.
  void settle_sharing(Lock& lock) {
    if (!shared) return;
    changed.wait(lock, [this] { return metadata_known_ || status; });
    shared->withdraw();
    if (!shared_accepted_) {
      shared.reset();
    } else if (!released_) {
      start_read(lock);
    }
  }
  /// Nothing more is started: OnDone may come.
  void release(Lock& lock) {
    released_ = true;
    remove_hold(lock);
  }
  bool released() const { return released_; }
  void cancel() { context_.TryCancel(); }

  /// The stream has ended, or more than one thread waits for what has changed.
  void notify_all() {
    notify_reader();
    may_write.notify_all();
  }

  mutable std::mutex mutex;
  std::condition_variable changed;    ///< an answer, the status, or the end
  std::condition_variable may_write;  ///< a write is through, the window has room, or the end
  Response response;
  std::unique_ptr<SharedFrames> shared;   ///< offered, until `opened`; then null, or in use
  bool reading = false, writing = false;  ///< asked for, and not there yet
  bool read_ok = true, write_ok = true, undecodable = false;
  std::optional<grpc::Status> status;

 private:
  void notify_reader() {
    changed.notify_all();
    if (shared) shared->ring();
  }
  template <typename Action>
  void outside(Lock& lock, Action action) {
    ++starting_;
    lock.unlock();
    action();
    lock.lock();
    --starting_;
    remove_hold(lock);
  }
  void remove_hold(Lock& lock) {
    if (!released_ || starting_ > 0 || hold_removed_) return;
    hold_removed_ = true;
    lock.unlock();
    this->RemoveHold();
    lock.lock();
  }

  void OnReadInitialMetadataDone(bool ok) override {
    const std::lock_guard lock(mutex);
    metadata_known_ = true;
    shared_accepted_ = ok && context_.GetServerInitialMetadata().contains(SharedFrames::kKey);
    changed.notify_all();
  }
  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex);
    reading = false;
    read_ok = ok;
    undecodable = !ok && !has_end_mark(response);
    notify_reader();
  }
  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex);
    writing = false;
    write_ok = write_ok && ok;
    may_write.notify_all();
  }
  void OnDone(const grpc::Status& final_status) override {
    const std::shared_ptr<Call> last = std::move(self_);
    const std::lock_guard lock(mutex);
    status = final_status;
    notify_all();
  }

  grpc::ClientContext context_;
  int starting_ = 0;
  bool released_ = false, hold_removed_ = false;
  bool metadata_known_ = false, shared_accepted_ = false;
  std::shared_ptr<Call> self_;
};

template <typename Request, typename Response>
FrameStream<Request, Response>::FrameStream(const Starter& start, FrameStreamOptions options)
    : options_(std::move(options)),
      call_(Call::start(start, options_.same_host ? SharedFrames::offer(options_.window) : nullptr)) {}

template <typename Request, typename Response>
FrameStream<Request, Response>::~FrameStream() {
  // What the peer can end at once has ended when we are gone; a peer that hangs is not waited for.
  constexpr std::chrono::milliseconds kLastWait{200};
  Lock lock(call_->mutex);
  if (!ended_) fail(lock, Error(ErrorCode::kCancelled, options_.peer + ": cancelled"));
  call_->changed.wait_for(lock, kLastWait, [&] { return call_->status.has_value(); });
}

template <typename Request, typename Response>
auto FrameStream<Request, Response>::open(const Request& request) {
  write(request, false, false);
  Response response;
  if (!pop(&response)) throw Error(ErrorCode::kUnavailable, options_.peer + " closed the stream before `opened`");
  if (!response.has_opened()) {
    cancel();
    throw_internal(options_.peer + " sent a frame before `opened`");
  }
  Lock lock(call_->mutex);
  call_->settle_sharing(lock);
  opened_ = true;
  return response.opened();
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::push(const Request& request) {
  write(request, true, true);
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::try_push(const Request& request) {
  return write(request, true, false);
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::send(const Request& request) {
  write(request, false, false);
}

/// Starts the write. gRPC has a copy of the request by then, so that only the next write waits until this one is
/// through.
template <typename Request, typename Response>
bool FrameStream<Request, Response>::write(const Request& request, bool counted, bool wait) {
  const std::lock_guard write_lock(write_mutex_);
  Lock lock(call_->mutex);
  if (counted) {
    const auto has_room = [&] { return ended_ || in_flight_ < options_.window; };
    if (wait) call_->may_write.wait(lock, has_room);
    if (!has_room()) return false;
  }
  wait_for_peer(lock, call_->may_write, write_since_, [&] { return !call_->writing; });
  throw_if_ending(lock);
  if (!call_->write_ok) throw_write_failure(lock);
  if (ended_ || closed_) throw Error(ErrorCode::kFailedPrecondition, options_.peer + ": the stream is closed");
  if (counted) ++in_flight_;
  write_since_ = last_sign_ = Clock::now();
  if (opened_ && call_->shared) {
    lock.unlock();
    const bool sent = call_->shared->send(request);
    lock.lock();
    if (sent) return true;
    throw_if_ending(lock);
  }
  call_->start_write(lock, request);
  return true;
}

/// A call that is ending tells its cause with its end. With the lock.
template <typename Request, typename Response>
void FrameStream<Request, Response>::throw_if_ending(Lock& lock) {
  if (call_->released()) call_->changed.wait(lock, [&] { return ended_; });
  throw_if_ended_badly();
}

/// The cause of a write that failed comes with the status, and that only after reading has ended: here, unless another
/// thread reads.
template <typename Request, typename Response>
void FrameStream<Request, Response>::throw_write_failure(Lock& lock) {
  Response dropped;
  while (!ended_) {
    if (reading_) {
      call_->changed.wait(lock, [&] { return ended_ || !reading_; });
    } else if (!read(lock, &dropped)) {
      take_status(lock);
    }
  }
  throw_if_ended_badly();
  throw Error(ErrorCode::kUnavailable, options_.peer + " ended the stream");
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::pop(Response* response) {
  Lock lock(call_->mutex);
  // A writer that failed may be taking the status: one reader at a time.
  call_->changed.wait(lock, [&] { return ended_ || !reading_; });
  if (!ended_) {
    if (read(lock, response)) {
      if (in_flight_ > 0 && opened_) --in_flight_;
      call_->may_write.notify_all();
      return true;
    }
    take_status(lock);
  }
  throw_if_ended_badly();
  return false;
}

/// One answer. False: none will come. With the lock, and no other reader.
template <typename Request, typename Response>
bool FrameStream<Request, Response>::read(Lock& lock, Response* response) {
  reading_ = true;
  const bool got = opened_ && call_->shared ? read_shared(lock, response) : read_call(lock, response);
  reading_ = false;
  if (got) last_sign_ = Clock::now();
  call_->changed.notify_all();
  return got;
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::read_call(Lock& lock, Response* response) {
  call_->start_read(lock);
  const bool done = wait_for_peer(lock, call_->changed, Clock::now(), [&] { return !call_->reading; });
  if (done && call_->undecodable) fail(lock, undecodable_answer());
  if (!done || ended_ || !call_->read_ok) return false;
  response->Swap(&call_->response);
  return true;
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::read_shared(Lock& lock, Response* response) {
  SharedFrames& shared = *call_->shared;
  // The call's own read is through when the stream has ended.
  wait_for_peer(
      lock, call_->changed, Clock::now(), [&] { return shared.available() || !call_->reading; }, &shared);
  if (ended_) return false;
  if (!shared.available()) {
    if (call_->read_ok || call_->undecodable) fail(lock, undecodable_answer());
    return false;
  }
  lock.unlock();
  const bool parsed = shared.receive(response);
  lock.lock();
  if (!parsed) fail(lock, undecodable_answer());
  return parsed && !ended_;
}

template <typename Request, typename Response>
Error FrameStream<Request, Response>::undecodable_answer() const {
  return Error(ErrorCode::kInternal, options_.peer + " sent bytes that are no message of this stream");
}

/// Waits until `done`, or until the stream has ended, which it does when the peer is silent for the time-out: since
/// `since`, and since the last answer. Between frames nothing is expected. True: done.
/// bell: rung when something may have changed, instead of `changed`.
template <typename Request, typename Response>
template <typename Done>
bool FrameStream<Request, Response>::wait_for_peer(Lock& lock, std::condition_variable& changed,
                                                   Clock::time_point since, Done done, const SharedFrames* bell) {
  while (true) {
    const std::uint32_t rings = bell != nullptr ? bell->rings() : 0;
    if (ended_ || done()) return done();
    const bool expected = !opened_ || call_->writing || in_flight_ > 0 || options_.server_driven;
    const auto timeout = opened_ ? options_.frame_timeout : options_.open_timeout;
    const auto now = Clock::now();
    // What is asked for from now on has the whole time-out: it is early enough to look again then.
    const auto deadline = expected ? std::max(since, last_sign_) + timeout : now + timeout;
    if (now >= deadline) {
      fail(lock, Error(ErrorCode::kDeadlineExceeded,
                       options_.peer + ": no answer within " + std::to_string(timeout.count()) + " ms"));
    } else if (bell == nullptr) {
      changed.wait_until(lock, deadline);
    } else {
      lock.unlock();
      bell->wait(rings, deadline);
      lock.lock();
    }
  }
}

/// After the last answer: how the stream has ended. With the lock.
template <typename Request, typename Response>
void FrameStream<Request, Response>::take_status(Lock& lock) {
  if (ended_) return;
  reading_ = true;  // the one who takes it
  call_->release(lock);
  wait_for_peer(lock, call_->changed, Clock::now(), [&] { return call_->status.has_value(); });
  reading_ = false;
  if (ended_) return;
  const grpc::Status& status = *call_->status;
  if (status.error_code() == grpc::StatusCode::CANCELLED) {
    error_.emplace(ErrorCode::kUnavailable, options_.peer + " ended the stream: " + status.error_message());
  } else if (!status.ok()) {
    error_.emplace(to_error(status, options_.peer));
  } else if (in_flight_ > 0) {
    error_.emplace(ErrorCode::kUnavailable, options_.peer + " ended the stream with frames unanswered");
  }
  ended_ = true;
  call_->notify_all();
}

/// Ends the stream at once, and leaves the call to gRPC. With the lock.
template <typename Request, typename Response>
void FrameStream<Request, Response>::fail(Lock& lock, const Error& error) {
  if (ended_) return;
  ended_ = true;
  error_ = error;
  call_->notify_all();
  call_->cancel();
  call_->release(lock);
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::throw_if_ended_badly() const {
  if (ended_ && error_.has_value()) throw *error_;
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::close() {
  const std::lock_guard write_lock(write_mutex_);
  Lock lock(call_->mutex);
  if (closed_ || ended_) return;
  closed_ = true;
  if (!wait_for_peer(lock, call_->may_write, write_since_, [&] { return !call_->writing; })) return;
  if (opened_ && call_->shared) call_->shared->close();
  if (!call_->released()) call_->start_writes_done(lock);
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::cancel() {
  Lock lock(call_->mutex);
  fail(lock, Error(ErrorCode::kCancelled, options_.peer + ": cancelled"));
}

template <typename Request, typename Response>
std::uint32_t FrameStream<Request, Response>::in_flight() const {
  const std::lock_guard lock(call_->mutex);
  return in_flight_;
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::shares_memory() const {
  const std::lock_guard lock(call_->mutex);
  return opened_ && call_->shared != nullptr;
}

}  // namespace pleat::rpc
