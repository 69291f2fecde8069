// Implementation of stream.hpp's templates: the server's side.
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

  /// From now on the client also has to take what it is sent through shared memory: something within each `limit`.
  void expect_taking(const SharedFrames& shared, std::chrono::milliseconds limit) {
    const std::lock_guard lock(mutex_);
    shared_ = &shared;
    taking_limit_ = limit;
  }
  void expect_within(std::chrono::milliseconds limit) { deadline_ = (Clock::now() + limit).time_since_epoch().count(); }
  void expect_nothing() { deadline_ = kNever; }
  bool timed_out() const { return timed_out_; }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::rep kNever = std::numeric_limits<Clock::rep>::max();

  void run() {
    std::unique_lock lock(mutex_);
    while (!changed_.wait_for(lock, step_, [this] { return over_; })) {
      if (Clock::now().time_since_epoch().count() < deadline_ && is_taking()) continue;
      timed_out_ = true;
      context_->TryCancel();
      return;
    }
  }

  bool is_taking() {
    if (shared_ == nullptr) return true;
    const auto now = Clock::now();
    if (shared_->on_their_way() == 0 || shared_->taken() != taken_) taken_since_ = now;
    taken_ = shared_->taken();
    return now - taken_since_ < taking_limit_;
  }

  grpc::ServerContext* const context_;
  const std::chrono::milliseconds step_;
  const SharedFrames* shared_ = nullptr;
  std::chrono::milliseconds taking_limit_{};
  std::uint32_t taken_ = 0;  ///< by the client, since then nothing
  Clock::time_point taken_since_{};
  std::atomic<Clock::rep> deadline_{kNever};
  std::atomic<bool> timed_out_{false};
  std::mutex mutex_;
  std::condition_variable changed_;
  bool over_ = false;
  std::thread thread_;
};

/// The frames and answers of one served stream: in the call, or in memory shared with the client.
template <typename Request, typename Response>
class ServedMessages {
 public:
  using Stream = grpc::ServerReaderWriter<Response, Request>;

  /// shared: null for the call.
  ServedMessages(grpc::ServerContext* context, Stream* stream, SharedFrames* shared)
      : context_(context), stream_(stream), shared_(shared) {}

  /// From any thread: whoever reads soon finds that the client sends nothing more. A call can't be told, and is
  /// cancelled.
  void stop_reading() {
    if (shared_ == nullptr) return context_->TryCancel();
    stopped_ = true;
    shared_->ring();
  }
  bool wait_in_memory() const { return shared_ != nullptr; }
  /// As gRPC's: false if the client sends nothing more, or has gone, or sent what is no message.
  bool read(Request* request) {
    if (shared_ == nullptr) return stream_->Read(request);
    // That the client has gone is known to gRPC, which tells who asks.
    constexpr std::chrono::milliseconds kLook{100};
    while (true) {
      const std::uint32_t rings = shared_->rings();
      const bool closed = shared_->closed();
      if (stopped_) return false;
      if (shared_->available()) return shared_->receive(request);
      if (closed) return false;
      if (!shared_->wait(rings, std::chrono::steady_clock::now() + kLook) && context_->IsCancelled()) return false;
    }
  }
  bool write(const Response& response) {
    // What the memory does not hold is for gRPC to refuse.
    return (shared_ != nullptr && shared_->send(response)) || stream_->Write(response);
  }

 private:
  grpc::ServerContext* const context_;
  Stream* const stream_;
  SharedFrames* const shared_;
  std::atomic<bool> stopped_{false};
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

/// One served stream: one thread more than frames at a time (concurrency), all alike, of which one reads while the
/// others process and write. Who has read a frame processes and answers it, and another takes over the reading; a frame
/// that comes alone waits for no thread to wake up.
template <typename Request, typename Response, typename Process>
class ServedStream {
 public:
  using Messages = ServedMessages<Request, Response>;

  ServedStream(grpc::ServerContext* context, Messages& messages, const FrameServiceOptions& options,
               std::uint32_t window, const Process& process, ClientWatch& watch, const telemetry::TraceContext& trace)
      : context_(context),
        messages_(messages),
        options_(options),
        concurrency_(std::max<std::size_t>(1, options.concurrency)),
        process_(process),
        watch_(watch),
        trace_(trace),
        slots_(window) {
    for (Slot& slot : slots_) free_.push_back(&slot);
  }

  /// Until the client has no more and everything is answered, or it has gone.
  grpc::Status run() {
    const Drain::Watch drain(options_.drain, [this] {
      const std::lock_guard lock(mutex_);
      draining_ = true;
      stop_reading_if_idle();
      changed_.notify_all();
    });
    Threads threads([this] {
      const std::lock_guard lock(mutex_);
      broken_ = true;
      changed_.notify_all();
      context_->TryCancel();  // a reader that waits for the client ends at once
    });
    // Shared memory holds the frames that wait: nobody has to read ahead.
    const std::size_t others = messages_.wait_in_memory() ? concurrency_ - 1 : concurrency_;
    for (std::size_t i = 0; i < others; ++i) {
      threads.start([this] {
        const telemetry::TraceScope scope(trace_);
        work();
      });
    }
    work();
    threads.join_at_ease();  // all end when the last frame is answered, or when one finds that the client has gone
    if (watch_.timed_out()) return {grpc::StatusCode::DEADLINE_EXCEEDED, "the client was silent, or did not read"};
    const std::lock_guard lock(mutex_);
    if (broken_) return {grpc::StatusCode::CANCELLED, "the client has gone"};
    if (draining_ && !closed_ && status_.ok()) return {grpc::StatusCode::UNAVAILABLE, Drain::kCause};
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
  bool may_read() const { return !reading_ && !no_more_ && !draining_ && !free_.empty(); }
  bool is_over() const { return (no_more_ || (draining_ && !reading_)) && order_.empty(); }
  /// When nothing is left to be answered. With the lock.
  void stop_reading_if_idle() {
    if (draining_ && reading_ && order_.empty()) messages_.stop_reading();
  }

  void work() {
    Lock lock(mutex_);
    while (!broken_) {
      if (may_write()) {
        write_oldest(lock);
      } else if (may_process()) {
        process_next(lock);
      } else if (may_read()) {
        read_next(lock);
      } else if (is_over()) {
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
      read = messages_.read(&slot->request);
    });
    reading_ = false;
    const bool frame = read && slot->request.has_frame();
    closed_ = !read && !draining_;
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
    outside(lock, [&] { written = messages_.write(slot->response); });
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
    stop_reading_if_idle();
    if (is_over()) changed_.notify_all();
  }

  grpc::ServerContext* const context_;
  Messages& messages_;
  const FrameServiceOptions& options_;
  const std::size_t concurrency_;
  const Process& process_;
  ClientWatch& watch_;
  const telemetry::TraceContext& trace_;
  std::vector<Slot> slots_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Slot*> free_;     ///< read into these
  std::deque<Slot*> waiting_;  ///< to be processed
  std::deque<Slot*> order_;    ///< all in flight, oldest first
  std::size_t processing_ = 0;
  bool reading_ = false, writing_ = false;
  bool no_more_ = false;  ///< nothing more is read
  bool closed_ = false;   ///< because the client sends nothing more
  bool draining_ = false;
  bool broken_ = false;  ///< the client has gone
  grpc::Status status_ = grpc::Status::OK;
};

}  // namespace detail

template <typename Request, typename Response, typename Open>
grpc::Status serve_frames(grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream,
                          const FrameServiceOptions& options, Open&& open) {
  return run_by_priority(*context, [&] {
    return guard([&]() -> grpc::Status {
      const telemetry::TraceContext trace = trace_of(*context);
      const telemetry::TraceScope scope(trace);
      std::unique_ptr<SharedFrames> shared;
      detail::ClientWatch watch(context, std::min(options.idle_timeout, options.reader_timeout) / 4);
      watch.expect_within(options.idle_timeout);
      Request first;
      set_end_mark(&first);
      if (!stream->Read(&first)) {
        if (!has_end_mark(first)) return undecodable();
        return watch.timed_out() ? grpc::Status(grpc::StatusCode::DEADLINE_EXCEEDED, "no `open` came")
                                 : grpc::Status::OK;
      }
      watch.expect_nothing();
      if (!first.has_open()) throw_invalid_argument("the first message of a stream must be `open`");
      if (options.drain != nullptr) options.drain->require_none();
      const std::uint32_t window = checked_window(first.open().window());
      const detail::SessionCount session(options.metrics);
      Response opened;
      const auto process = open(first.open(), opened.mutable_opened());
      first.Clear();
      shared = accept_shared_frames(*context, window);
      if (shared != nullptr) watch.expect_taking(*shared, options.reader_timeout);
      watch.expect_within(options.reader_timeout);
      if (!stream->Write(opened)) return grpc::Status(grpc::StatusCode::CANCELLED, "the client has gone");
      watch.expect_within(options.idle_timeout);

      using Messages = detail::ServedMessages<Request, Response>;
      Messages messages(context, stream, shared.get());
      return detail::ServedStream<Request, Response, std::decay_t<decltype(process)>>(context, messages, options,
                                                                                      window, process, watch, trace)
          .run();
    });
  });
}

template <typename Request, typename Response>
PacedWriter<Request, Response>::PacedWriter(grpc::ServerContext* context,
                                            grpc::ServerReaderWriter<Response, Request>* stream, std::uint32_t window,
                                            std::uint64_t next_index, Drain* drain)
    : context_(context),
      stream_(stream),
      window_(window),
      acknowledged_(next_index),
      drain_watch_(drain,
                   [this] {
                     const std::lock_guard lock(mutex_);
                     draining_ = true;
                     changed_.notify_all();
                   }),
      reader_([this] { read(); }) {}

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
    if (!changed_.wait_for(lock, kIdleTimeout, [&] { return draining_ || may_write(); })) {
      throw Error(ErrorCode::kDeadlineExceeded,
                  "the client has acknowledged nothing for " + std::to_string(kIdleTimeout.count()) + " s");
    }
    throw_if_broken();
    if (stopped_) return false;
    if (!may_write()) throw Error(ErrorCode::kUnavailable, Drain::kCause);
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
  changed_.wait_for(lock, kIdleTimeout, [&] { return stopped_ || draining_; });
  throw_if_broken();
}

/// With the lock.
template <typename Request, typename Response>
void PacedWriter<Request, Response>::throw_if_broken() const {
  if (broken_) throw_invalid_argument("after `open` only acknowledgements may follow");
}

}  // namespace pleat::rpc
