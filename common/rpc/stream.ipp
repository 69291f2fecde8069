// Implementation of stream.hpp's templates.
#pragma once

namespace pleat::rpc {

namespace detail {

/// The state that the reader, the workers and the writer of one served stream share.
template <typename Request, typename Response>
struct ServedStream {
  struct Slot {
    Request request;
    Response response;
    bool done = false;
  };

  explicit ServedStream(std::uint32_t window) : slots(window) {
    for (Slot& slot : slots) free.push_back(&slot);
  }

  std::vector<Slot> slots;
  std::mutex mutex;
  std::condition_variable changed;
  std::deque<Slot*> free;     ///< read into these
  std::deque<Slot*> waiting;  ///< to be processed
  std::deque<Slot*> order;    ///< all in flight, oldest first
  bool no_more = false;       ///< the reader has ended
  bool broken = false;        ///< the client has gone
  grpc::Status status = grpc::Status::OK;
};

template <typename Response>
void set_frame_error(Response* response, std::uint64_t index, const grpc::Status& status) {
  response->Clear();
  auto* error = response->mutable_error();
  error->set_index(index);
  error->set_code(static_cast<int>(status.error_code()));
  error->set_message(status.error_message());
}

template <typename Request, typename Response, typename Process>
void process_slot(typename ServedStream<Request, Response>::Slot& slot, const Process& process,
                  const FrameServiceOptions& options) {
  const std::uint64_t index = frame_index(slot.request.frame());
  telemetry::StageTimer timer;
  if (options.metrics != nullptr) options.metrics->add_inflight(options.stage, 1);
  const grpc::Status status = guard([&] {
    slot.response.Clear();
    if constexpr (std::is_invocable_v<Process, const Request&, decltype(slot.response.mutable_frame())>) {
      process(slot.request, slot.response.mutable_frame());
    } else {
      process(slot.request.frame(), slot.response.mutable_frame());
    }
  });
  const double ms = timer.milliseconds();
  if (!status.ok()) {
    set_frame_error(&slot.response, index, status);
  } else if constexpr (requires { slot.response.mutable_frame()->add_stage_times(); }) {
    if (!options.stage.empty()) {
      auto* time = slot.response.mutable_frame()->add_stage_times();
      time->set_stage(options.stage);
      time->set_ms(ms);
    }
  }
  if (options.metrics != nullptr) {
    options.metrics->add_inflight(options.stage, -1);
    options.metrics->frame_done(options.stage, ms * 1e-3, status.ok());
  }
}

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

}  // namespace detail

template <typename Request, typename Response, typename Open>
grpc::Status serve_frames(grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream,
                          const FrameServiceOptions& options, Open&& open) {
  return guard([&]() -> grpc::Status {
    Request first;
    if (!stream->Read(&first)) return grpc::Status::OK;
    if (!first.has_open()) throw_invalid_argument("the first message of a stream must be `open`");
    const std::uint32_t window = checked_window(first.open().window());
    const detail::SessionCount session(options.metrics);
    Response opened;
    const auto process = open(first.open(), opened.mutable_opened());
    first.Clear();
    if (!stream->Write(opened)) return grpc::Status(grpc::StatusCode::CANCELLED, "the client has gone");

    using Shared = detail::ServedStream<Request, Response>;
    Shared shared(window);

    std::thread reader([&] {
      std::unique_lock lock(shared.mutex);
      while (true) {
        shared.changed.wait(lock, [&] { return !shared.free.empty() || shared.broken; });
        if (shared.broken) break;
        auto* slot = shared.free.front();
        shared.free.pop_front();
        slot->done = false;
        lock.unlock();
        const bool read = stream->Read(&slot->request);
        lock.lock();
        if (!read) break;
        if (!slot->request.has_frame()) {
          shared.status = grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "after `open` only frames may follow");
          break;
        }
        shared.order.push_back(slot);
        shared.waiting.push_back(slot);
        shared.changed.notify_all();
      }
      shared.no_more = true;
      shared.changed.notify_all();
    });

    std::vector<std::thread> workers;
    for (std::size_t i = 0; i < std::max<std::size_t>(1, options.concurrency); ++i) {
      workers.emplace_back([&] {
        std::unique_lock lock(shared.mutex);
        while (true) {
          shared.changed.wait(lock, [&] { return !shared.waiting.empty() || shared.no_more || shared.broken; });
          if (shared.broken || shared.waiting.empty()) return;
          auto* slot = shared.waiting.front();
          shared.waiting.pop_front();
          lock.unlock();
          detail::process_slot<Request, Response>(*slot, process, options);
          lock.lock();
          slot->done = true;
          shared.changed.notify_all();
        }
      });
    }

    {
      std::unique_lock lock(shared.mutex);
      while (true) {
        shared.changed.wait(lock, [&] { return shared.order.empty() ? shared.no_more : shared.order.front()->done; });
        if (shared.order.empty()) break;
        auto* slot = shared.order.front();
        lock.unlock();
        const bool written = stream->Write(slot->response);
        lock.lock();
        if (!written) break;
        shared.order.pop_front();
        shared.free.push_back(slot);
        shared.changed.notify_all();
      }
      shared.broken = !shared.order.empty();
      shared.changed.notify_all();
    }
    if (shared.broken) context->TryCancel();  // a reader that waits for the client ends at once
    reader.join();
    for (std::thread& worker : workers) worker.join();
    if (shared.broken) return grpc::Status(grpc::StatusCode::CANCELLED, "the client has gone");
    return shared.status;
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
  while (stream_->Read(&request)) {
    if (!request.has_ack_index()) break;
    const std::lock_guard lock(mutex_);
    acknowledged_ = std::max(acknowledged_, request.ack_index() + 1);
    changed_.notify_all();
  }
  const std::lock_guard lock(mutex_);
  stopped_ = true;
  changed_.notify_all();
}

template <typename Request, typename Response>
bool PacedWriter<Request, Response>::write(std::uint64_t index, const Response& response) {
  {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return stopped_ || index < acknowledged_ + window_; });
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
  changed_.wait(lock, [&] { return stopped_; });
}

template <typename Request, typename Response>
FrameStream<Request, Response>::FrameStream(const Starter& start, FrameStreamOptions options)
    : options_(std::move(options)), stream_(start(&context_)), watchdog_([this] { watch(); }) {}

template <typename Request, typename Response>
FrameStream<Request, Response>::~FrameStream() {
  {
    std::unique_lock lock(mutex_);
    if (!ended_) {
      cancelled_ = true;
      context_.TryCancel();
      changed_.wait(lock, [&] { return !reading_since_.has_value(); });
      if (!ended_) end(lock);
    }
    destroyed_ = true;
    changed_.notify_all();
  }
  watchdog_.join();
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
  const std::lock_guard lock(mutex_);
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

template <typename Request, typename Response>
bool FrameStream<Request, Response>::write(const Request& request, bool counted, bool wait) {
  const std::lock_guard write_lock(write_mutex_);
  {
    std::unique_lock lock(mutex_);
    if (counted) {
      const auto has_room = [&] { return ended_ || in_flight_ < options_.window; };
      if (wait) changed_.wait(lock, has_room);
      if (!has_room()) return false;
    }
    throw_if_ended_badly();
    if (ended_ || closed_) throw Error(ErrorCode::kFailedPrecondition, options_.peer + ": the stream is closed");
    if (counted) {
      ++in_flight_;
      last_push_ = Clock::now();
      changed_.notify_all();
    }
  }
  if (stream_->Write(request)) return true;
  std::unique_lock lock(mutex_);
  write_failed(lock);
  return false;
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::write_failed(std::unique_lock<std::mutex>& lock) {
  // The cause comes with the status, and that only after reading has ended: here, unless another thread reads.
  changed_.wait(lock, [&] { return ended_ || !reading_since_.has_value(); });
  if (!ended_) end(lock);
  throw_if_ended_badly();
  throw Error(ErrorCode::kUnavailable, options_.peer + " ended the stream");
}

template <typename Request, typename Response>
bool FrameStream<Request, Response>::pop(Response* response) {
  std::unique_lock lock(mutex_);
  // A writer that failed may be taking the status: one reader at a time.
  changed_.wait(lock, [&] { return ended_ || !reading_since_.has_value(); });
  if (ended_) {
    throw_if_ended_badly();
    return false;
  }
  reading_since_ = Clock::now();
  changed_.notify_all();
  lock.unlock();
  const bool read = stream_->Read(response);
  lock.lock();
  reading_since_.reset();
  if (read) {
    if (in_flight_ > 0 && opened_) --in_flight_;
    changed_.notify_all();
    return true;
  }
  end(lock);
  throw_if_ended_badly();
  return false;
}

/// Reads what is left, takes the status. With the lock, and no other reader.
template <typename Request, typename Response>
void FrameStream<Request, Response>::end(std::unique_lock<std::mutex>& lock) {
  reading_since_ = Clock::now();
  lock.unlock();
  Response rest;
  while (stream_->Read(&rest)) {
  }
  const grpc::Status status = stream_->Finish();
  lock.lock();
  reading_since_.reset();
  if (cancelled_) {
    error_.emplace(ErrorCode::kCancelled, options_.peer + ": cancelled");
  } else if (timed_out_) {
    const auto timeout = opened_ ? options_.frame_timeout : options_.open_timeout;
    error_.emplace(ErrorCode::kDeadlineExceeded,
                   options_.peer + ": no answer within " + std::to_string(timeout.count()) + " ms");
  } else if (status.error_code() == grpc::StatusCode::CANCELLED) {
    error_.emplace(ErrorCode::kUnavailable, options_.peer + " ended the stream: " + status.error_message());
  } else if (!status.ok()) {
    error_.emplace(to_error(status, options_.peer));
  } else if (in_flight_ > 0) {
    error_.emplace(ErrorCode::kUnavailable, options_.peer + " ended the stream with frames unanswered");
  }
  ended_ = true;
  changed_.notify_all();
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::throw_if_ended_badly() const {
  if (ended_ && error_.has_value()) throw *error_;
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::close() {
  const std::lock_guard write_lock(write_mutex_);
  {
    const std::lock_guard lock(mutex_);
    if (closed_ || ended_) return;
    closed_ = true;
  }
  // Without the lock: cancel(), which gRPC's own threads may call, must never wait for the network.
  stream_->WritesDone();
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::cancel() {
  const std::lock_guard lock(mutex_);
  if (ended_) return;
  cancelled_ = true;
  context_.TryCancel();
}

template <typename Request, typename Response>
std::uint32_t FrameStream<Request, Response>::in_flight() const {
  const std::lock_guard lock(mutex_);
  return in_flight_;
}

template <typename Request, typename Response>
void FrameStream<Request, Response>::watch() {
  std::unique_lock lock(mutex_);
  while (!destroyed_) {
    if (ended_ || timed_out_ || cancelled_ || !reading_since_.has_value() ||
        (opened_ && in_flight_ == 0 && !options_.server_driven)) {
      changed_.wait(lock);
      continue;
    }
    const auto since = opened_ ? std::max(*reading_since_, last_push_) : *reading_since_;
    const auto deadline = since + (opened_ ? options_.frame_timeout : options_.open_timeout);
    if (Clock::now() >= deadline) {
      timed_out_ = true;
      context_.TryCancel();
    } else {
      changed_.wait_until(lock, deadline);
    }
  }
}

}  // namespace pleat::rpc
