// Implementation of stream.hpp's templates.
#pragma once

namespace pleat::rpc {

namespace detail {

template <typename Response>
void set_frame_error(Response* response, std::uint64_t index, const grpc::Status& status) {
  response->Clear();
  auto* error = response->mutable_error();
  error->set_index(index);
  error->set_code(static_cast<int>(status.error_code()));
  error->set_message(status.error_message());
}

template <typename Request, typename Response, typename Process>
void process_frame(const Request& request, Response& response, const Process& process,
                   const FrameServiceOptions& options) {
  const std::uint64_t index = frame_index(request.frame());
  telemetry::StageTimer timer;
  if (options.metrics != nullptr) options.metrics->add_inflight(options.stage, 1);
  const grpc::Status status = guard([&] {
    response.Clear();
    if constexpr (std::is_invocable_v<Process, const Request&, decltype(response.mutable_frame())>) {
      process(request, response.mutable_frame());
    } else {
      process(request.frame(), response.mutable_frame());
    }
  });
  const double ms = timer.milliseconds();
  if (!status.ok()) {
    set_frame_error(&response, index, status);
  } else if constexpr (requires { response.mutable_frame()->add_stage_times(); }) {
    if (!options.stage.empty()) {
      auto* time = response.mutable_frame()->add_stage_times();
      time->set_stage(options.stage);
      time->set_ms(ms);
    }
  }
  if (options.metrics != nullptr) {
    options.metrics->add_inflight(options.stage, -1);
    options.metrics->frame_done(options.stage, ms * 1e-3, status.ok());
  }
}

/// Threads of one handler. If the system has none to spare, or the handler throws, those there are end before it does.
class Threads {
 public:
  /// stop: makes every thread end soon.
  explicit Threads(std::function<void()> stop) : stop_(std::move(stop)) {}
  ~Threads() { stop_and_join(); }
  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;

  template <typename Work>
  void start(Work work) {
    threads_.emplace_back(std::move(work));
  }
  /// When all end by themselves.
  void join_at_ease() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }
  void stop_and_join() {
    if (!threads_.empty()) stop_();
    join_at_ease();
  }

 private:
  std::function<void()> stop_;
  std::vector<std::thread> threads_;
};

/// Cuts off a client that owes something for too long. Looks every `step`, so that the hot path only notes the time.
class ClientWatch {
 public:
  ClientWatch(grpc::ServerContext* context, std::chrono::milliseconds step)
      : context_(context), step_(step), thread_([this] { run(); }) {}
  ~ClientWatch() {
    {
      const std::lock_guard lock(mutex_);
      over_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  ClientWatch(const ClientWatch&) = delete;
  ClientWatch& operator=(const ClientWatch&) = delete;

  void expect_within(std::chrono::milliseconds limit) { deadline_ = (Clock::now() + limit).time_since_epoch().count(); }
  void expect_nothing() { deadline_ = kNever; }
  bool timed_out() const { return timed_out_; }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::rep kNever = std::numeric_limits<Clock::rep>::max();

  void run() {
    std::unique_lock lock(mutex_);
    while (!changed_.wait_for(lock, step_, [this] { return over_; })) {
      if (Clock::now().time_since_epoch().count() < deadline_) continue;
      timed_out_ = true;
      context_->TryCancel();
      return;
    }
  }

  grpc::ServerContext* const context_;
  const std::chrono::milliseconds step_;
  std::atomic<Clock::rep> deadline_{kNever};
  std::atomic<bool> timed_out_{false};
  std::mutex mutex_;
  std::condition_variable changed_;
  bool over_ = false;
  std::thread thread_;
};

class SessionCount {
 public:
  explicit SessionCount(telemetry::Metrics* metrics) : metrics_(metrics) {
    if (metrics_ != nullptr) metrics_->add_sessions(1);
  }
  ~SessionCount() {
    if (metrics_ != nullptr) metrics_->add_sessions(-1);
  }
  SessionCount(const SessionCount&) = delete;
  SessionCount& operator=(const SessionCount&) = delete;

 private:
  telemetry::Metrics* metrics_;
};

/// One served stream: concurrency + 1 threads alike, of which one reads while the others process and write. Who has
/// read a frame processes and answers it, and another takes over the reading; a frame that comes alone waits for no
/// thread to wake up.
template <typename Request, typename Response, typename Process>
class ServedStream {
 public:
  using Stream = grpc::ServerReaderWriter<Response, Request>;

  ServedStream(grpc::ServerContext* context, Stream* stream, const FrameServiceOptions& options, std::uint32_t window,
               const Process& process, ClientWatch& watch)
      : context_(context),
        stream_(stream),
        options_(options),
        concurrency_(std::max<std::size_t>(1, options.concurrency)),
        process_(process),
        watch_(watch),
        slots_(window) {
    for (Slot& slot : slots_) free_.push_back(&slot);
  }

  /// Until the client has no more and everything is answered, or it has gone.
  grpc::Status run() {
    Threads threads([this] {
      const std::lock_guard lock(mutex_);
      broken_ = true;
      changed_.notify_all();
      context_->TryCancel();  // a reader that waits for the client ends at once
    });
    for (std::size_t i = 0; i < concurrency_; ++i) threads.start([this] { work(); });
    work();
    threads.join_at_ease();  // all end when the last frame is answered, or when one finds that the client has gone
    if (watch_.timed_out()) return {grpc::StatusCode::DEADLINE_EXCEEDED, "the client was silent, or did not read"};
    if (broken_) return {grpc::StatusCode::CANCELLED, "the client has gone"};
    return status_;
  }

 private:
  struct Slot {
    Request request;
    Response response;
    bool done = false;
  };
  using Lock = std::unique_lock<std::mutex>;

  bool may_write() const { return !writing_ && !order_.empty() && order_.front()->done; }
  bool may_process() const { return processing_ < concurrency_ && !waiting_.empty(); }
  bool may_read() const { return !reading_ && !no_more_ && !free_.empty(); }

  void work() {
    Lock lock(mutex_);
    while (!broken_) {
      if (may_write()) {
        write_oldest(lock);
      } else if (may_process()) {
        process_next(lock);
      } else if (may_read()) {
        read_next(lock);
      } else if (no_more_ && order_.empty()) {
        return;
      } else {
        changed_.wait(lock);
      }
    }
  }

  /// Without the lock. Whatever else there is to do is another thread's meanwhile.
  template <typename Action>
  void outside(Lock& lock, const Action& action) {
    const bool more = may_write() || may_process() || may_read();
    lock.unlock();
    if (more) changed_.notify_one();
    action();
    lock.lock();
  }

  void read_next(Lock& lock) {
    Slot* slot = free_.front();
    free_.pop_front();
    slot->done = false;
    bool read = false;
    reading_ = true;
    outside(lock, [&] {
      set_end_mark(&slot->request);
      read = stream_->Read(&slot->request);
    });
    reading_ = false;
    const bool frame = read && slot->request.has_frame();
    if (!read && !has_end_mark(slot->request)) status_ = undecodable();
    if (read && !frame) status_ = {grpc::StatusCode::INVALID_ARGUMENT, "after `open` only frames may follow"};
    if (!frame) {
      no_more_ = true;
      changed_.notify_all();
      return;
    }
    if (order_.empty()) watch_.expect_nothing();
    order_.push_back(slot);
    waiting_.push_back(slot);
  }

  void process_next(Lock& lock) {
    Slot* slot = waiting_.front();
    waiting_.pop_front();
    ++processing_;
    outside(lock, [&] { process_frame(slot->request, slot->response, process_, options_); });
    --processing_;
    slot->done = true;
  }

  void write_oldest(Lock& lock) {
    Slot* slot = order_.front();
    watch_.expect_within(options_.reader_timeout);
    bool written = false;
    writing_ = true;
    outside(lock, [&] { written = stream_->Write(slot->response); });
    writing_ = false;
    if (!written) {
      broken_ = true;
      changed_.notify_all();
      context_->TryCancel();
      return;
    }
    order_.pop_front();
    free_.push_back(slot);
    order_.empty() ? watch_.expect_within(options_.idle_timeout) : watch_.expect_nothing();
    if (no_more_ && order_.empty()) changed_.notify_all();
  }

  grpc::ServerContext* const context_;
  Stream* const stream_;
  const FrameServiceOptions& options_;
  const std::size_t concurrency_;
  const Process& process_;
  ClientWatch& watch_;
  std::vector<Slot> slots_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Slot*> free_;     ///< read into these
  std::deque<Slot*> waiting_;  ///< to be processed
  std::deque<Slot*> order_;    ///< all in flight, oldest first
  std::size_t processing_ = 0;
  bool reading_ = false, writing_ = false;
  bool no_more_ = false;  ///< the client sends nothing more
  bool broken_ = false;   ///< the client has gone
  grpc::Status status_ = grpc::Status::OK;
};

}  // namespace detail

template <typename Request, typename Response, typename Open>
grpc::Status serve_frames(grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream,
                          const FrameServiceOptions& options, Open&& open) {
  return guard([&]() -> grpc::Status {
    detail::ClientWatch watch(context, std::min(options.idle_timeout, options.reader_timeout) / 4);
    watch.expect_within(options.idle_timeout);
    Request first;
    set_end_mark(&first);
    if (!stream->Read(&first)) {
      if (!has_end_mark(first)) return undecodable();
      return watch.timed_out() ? grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED, "no `open` came") : grpc::Status::OK;
    }
    watch.expect_nothing();
    if (!first.has_open()) throw_invalid_argument("the first message of a stream must be `open`");
    const std::uint32_t window = checked_window(first.open().window());
    const detail::SessionCount session(options.metrics);
    Response opened;
    const auto process = open(first.open(), opened.mutable_opened());
    first.Clear();
    watch.expect_within(options.reader_timeout);
    if (!stream->Write(opened)) return grpc::Status(grpc::StatusCode::CANCELLED, "the client has gone");
    watch.expect_within(options.idle_timeout);

    return detail::ServedStream<Request, Response, std::decay_t<decltype(process)>>(context, stream, options, window,
                                                                                    process, watch)
        .run();
  });
}

template <typename Request, typename Response>
PacedWriter<Request, Response>::PacedWriter(grpc::ServerContext* context,
                                            grpc::ServerReaderWriter<Response, Request>* stream, std::uint32_t window,
                                            std::uint64_t next_index)
    : context_(context), stream_(stream), window_(window), acknowledged_(next_index), reader_([this] { read(); }) {}

template <typename Request, typename Response>
PacedWriter<Request, Response>::~PacedWriter() {
  if (!stopped()) context_->TryCancel();
  reader_.join();
}

template <typename Request, typename Response>
void PacedWriter<Request, Response>::read() {
  Request request;
  set_end_mark(&request);
  while (stream_->Read(&request)) {
    if (!request.has_ack_index()) break;
    const std::lock_guard lock(mutex_);
    acknowledged_ = std::max(acknowledged_, request.ack_index() + 1);
    changed_.notify_all();
    set_end_mark(&request);
  }
  const std::lock_guard lock(mutex_);
  broken_ = !has_end_mark(request);
  stopped_ = true;
  changed_.notify_all();
}

template <typename Request, typename Response>
bool PacedWriter<Request, Response>::write(std::uint64_t index, const Response& response) {
  {
    std::unique_lock lock(mutex_);
    const auto may_write = [&] { return stopped_ || index < acknowledged_ + window_; };
    if (!changed_.wait_for(lock, kIdleTimeout, may_write)) {
      throw Error(ErrorCode::kDeadlineExceeded,
                  "the client has acknowledged nothing for " + std::to_string(kIdleTimeout.count()) + " s");
    }
    throw_if_broken();
    if (stopped_) return false;
  }
  return stream_->Write(response);
}

template <typename Request, typename Response>
bool PacedWriter<Request, Response>::stopped() const {
  const std::lock_guard lock(mutex_);
  return stopped_;
}

template <typename Request, typename Response>
void PacedWriter<Request, Response>::close() {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, kIdleTimeout, [&] { return stopped_; });
  throw_if_broken();
}

/// With the lock.
template <typename Request, typename Response>
void PacedWriter<Request, Response>::throw_if_broken() const {
  if (broken_) throw_invalid_argument("after `open` only acknowledgements may follow");
}

/// The call as gRPC sees it. It keeps itself alive until gRPC is done with it.
template <typename Request, typename Response>
class FrameStream<Request, Response>::Call final : public Reactor {
 public:
  static std::shared_ptr<Call> start(const Starter& start) {
    auto call = std::make_shared<Call>();
    call->self_ = call;
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
  /// Nothing more is started: OnDone may come.
  void release(Lock& lock) {
    released_ = true;
    remove_hold(lock);
  }
  bool released() const { return released_; }
  void cancel() { context_.TryCancel(); }

  /// The stream has ended, or more than one thread waits for what has changed.
  void notify_all() {
    changed.notify_all();
    may_write.notify_all();
  }

  mutable std::mutex mutex;
  std::condition_variable changed;    ///< an answer, the status, or the end
  std::condition_variable may_write;  ///< a write is through, the window has room, or the end
  Response response;
  bool reading = false, writing = false;  ///< asked for, and not there yet
  bool read_ok = true, write_ok = true, undecodable = false;
  std::optional<grpc::Status> status;

 private:
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

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex);
    reading = false;
    read_ok = ok;
    undecodable = !ok && !has_end_mark(response);
    changed.notify_all();
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
  std::shared_ptr<Call> self_;
};

template <typename Request, typename Response>
FrameStream<Request, Response>::FrameStream(const Starter& start, FrameStreamOptions options)
    : options_(std::move(options)), call_(Call::start(start)) {}

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
  const std::lock_guard lock(call_->mutex);
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
  // A call that is ending tells its cause with its end.
  if (call_->released()) call_->changed.wait(lock, [&] { return ended_; });
  throw_if_ended_badly();
  if (!call_->write_ok) throw_write_failure(lock);
  if (ended_ || closed_) throw Error(ErrorCode::kFailedPrecondition, options_.peer + ": the stream is closed");
  if (counted) ++in_flight_;
  write_since_ = last_sign_ = Clock::now();
  call_->start_write(lock, request);
  return true;
}

/// The cause of a write that failed comes with the status, and that only after reading has ended: here, unless another
/// thread reads.
template <typename Request, typename Response>
void FrameStream<Request, Response>::throw_write_failure(Lock& lock) {
  while (!ended_) {
    if (reading_) {
      call_->changed.wait(lock, [&] { return ended_ || !reading_; });
    } else if (!read(lock)) {
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
    if (read(lock)) {
      response->Swap(&call_->response);
      if (in_flight_ > 0 && opened_) --in_flight_;
      call_->may_write.notify_all();
      return true;
    }
    take_status(lock);
  }
  throw_if_ended_badly();
  return false;
}

/// One answer into the call's response. False: none will come. With the lock, and no other reader.
template <typename Request, typename Response>
bool FrameStream<Request, Response>::read(Lock& lock) {
  reading_ = true;
  call_->start_read(lock);
  const bool done = wait_for_peer(lock, call_->changed, Clock::now(), [&] { return !call_->reading; });
  reading_ = false;
  if (done && !ended_ && call_->read_ok) last_sign_ = Clock::now();
  if (done && call_->undecodable) {
    fail(lock, Error(ErrorCode::kInternal, options_.peer + " sent bytes that are no message of this stream"));
  }
  call_->changed.notify_all();
  return done && !ended_ && call_->read_ok;
}

/// Waits until `done`, or until the stream has ended, which it does when the peer is silent for the time-out: since
/// `since`, and since the last answer. Between frames nothing is expected. True: done.
template <typename Request, typename Response>
template <typename Done>
bool FrameStream<Request, Response>::wait_for_peer(Lock& lock, std::condition_variable& changed,
                                                   Clock::time_point since, Done done) {
  const auto over = [&] { return ended_ || done(); };
  while (!over()) {
    const bool expected = !opened_ || call_->writing || in_flight_ > 0 || options_.server_driven;
    const auto timeout = opened_ ? options_.frame_timeout : options_.open_timeout;
    const auto now = Clock::now();
    // What is asked for from now on has the whole time-out: it is early enough to look again then.
    const auto deadline = expected ? std::max(since, last_sign_) + timeout : now + timeout;
    if (now < deadline) {
      changed.wait_until(lock, deadline);
    } else {
      fail(lock, Error(ErrorCode::kDeadlineExceeded,
                       options_.peer + ": no answer within " + std::to_string(timeout.count()) + " ms"));
    }
  }
  return done();
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

}  // namespace pleat::rpc
