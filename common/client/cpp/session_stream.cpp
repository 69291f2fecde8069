#include "common/client/cpp/session_stream.hpp"

#include <algorithm>
#include <utility>

namespace pleat::client {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kCheckpointInterval = 25;
// More frames than this without a checkpoint: the coordinator makes none, or all its frames fail.
constexpr std::size_t kMostKept = 4 * kCheckpointInterval + rpc::kMaxWindow;
constexpr std::chrono::milliseconds kFirstPause{50}, kLongestPause{1000};

std::chrono::milliseconds left_until(Clock::time_point deadline) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now());
}

}  // namespace

SessionStream::SessionStream(Stream::Starter start, Options options, v1::EnhanceRequest open)
    : start_(std::move(start)),
      options_(std::move(options)),
      open_(std::move(open)),
      resumable_(options_.patience.count() > 0) {
  if (resumable_) open_.mutable_open()->set_checkpoint_interval(kCheckpointInterval);
  stream_ = make_stream(options_.stream.open_timeout);
  opened_ = stream_->open(open_);
  // What was left to the coordinator stays as it is.
  open_.mutable_open()->set_model(opened_.model());
  if (opened_.detail() != v1::DETAIL_UNSPECIFIED) open_.mutable_open()->set_detail(opened_.detail());
}

SessionStream::Request SessionStream::spare() {
  const std::lock_guard lock(mutex_);
  if (spare_.empty()) return std::make_unique<v1::EnhanceRequest>();
  Request request = std::move(spare_.back());
  spare_.pop_back();
  return request;
}

void SessionStream::push(Request request) { send(request, true); }

bool SessionStream::try_push(Request& request) { return send(request, false); }

bool SessionStream::send(Request& request, bool wait) {
  const std::lock_guard sending(send_mutex_);
  while (true) {
    throw_if_over();
    try {
      const auto stream = current().stream;
      if (wait) {
        stream->push(*request);
      } else if (!stream->try_push(*request)) {
        return false;
      }
      keep(std::move(request));
      return true;
    } catch (const Error& error) {
      recover(error);
    }
  }
}

bool SessionStream::pop(v1::EnhanceResponse* response) {
  while (true) {
    throw_if_over();
    const Current now = current();
    try {
      const bool got = now.stream->pop(response);
      const std::lock_guard lock(mutex_);
      if (now.generation != generation_) continue;  // the stream in its place answers this frame again
      if (!got) return false;
      ++answered_;
      note(response->checkpoint(), answered_);
      return true;
    } catch (const Error& error) {
      // Who pushes has met the end of this stream too, and may be about to open the next one, or wait for its window.
      std::unique_lock sending(send_mutex_, std::defer_lock);
      if (!lock_unless_replaced(sending, now.generation)) continue;
      {
        const std::lock_guard lock(mutex_);
        if (now.generation != generation_) continue;
        if (closed_ && answered_ == pushed_ && error.code() == ErrorCode::kUnavailable) return false;
      }
      recover(error);
    }
  }
}

/// False: the stream of this generation has been replaced, or the session is over.
bool SessionStream::lock_unless_replaced(std::unique_lock<std::mutex>& sending, std::uint64_t generation) {
  constexpr std::chrono::milliseconds kLook{5};
  while (!sending.try_lock()) {
    std::unique_lock lock(mutex_);
    if (changed_.wait_for(lock, kLook, [&] { return generation != generation_ || over_; })) return false;
  }
  return true;
}

void SessionStream::close() {
  const std::lock_guard sending(send_mutex_);
  std::shared_ptr<Stream> stream;
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    stream = stream_;
  }
  stream->close();
}

void SessionStream::cancel() {
  const std::lock_guard lock(mutex_);
  cancelled_ = true;
  stream_->cancel();
  if (next_stream_) next_stream_->cancel();
  changed_.notify_all();
}

SessionStream::Current SessionStream::current() {
  const std::lock_guard lock(mutex_);
  return {stream_, generation_};
}

void SessionStream::throw_if_over() {
  const std::lock_guard lock(mutex_);
  if (over_) throw *over_;
}

void SessionStream::keep(Request request) {
  const std::lock_guard lock(mutex_);
  const std::uint64_t sequence = pushed_++;
  if (resumable_ && sequence >= checkpointed_) {
    kept_.push_back({sequence, std::move(request)});
    if (kept_.size() <= kMostKept) return;
    resumable_ = false;
    for (Kept& kept : kept_) spare_.push_back(std::move(kept.request));
    kept_.clear();
  } else {
    spare_.push_back(std::move(request));
  }
}

/// With mutex_. frames: before the checkpoint. While kept frames are being sent again they stay where they are.
void SessionStream::note(const std::string& checkpoint, std::uint64_t frames) {
  if (checkpoint.empty() || !resumable_ || frames <= checkpointed_) return;
  if (resending_) {
    if (frames > later_frames_) {
      later_checkpoint_ = checkpoint;
      later_frames_ = frames;
    }
    return;
  }
  checkpoint_ = checkpoint;
  checkpointed_ = frames;
  for (; !kept_.empty() && kept_.front().sequence < frames; kept_.pop_front()) {
    spare_.push_back(std::move(kept_.front().request));
  }
}

std::shared_ptr<SessionStream::Stream> SessionStream::make_stream(std::chrono::milliseconds open_timeout) {
  rpc::FrameStreamOptions options = options_.stream;
  options.open_timeout = open_timeout;
  auto stream = std::make_shared<Stream>(start_, options);
  const std::lock_guard lock(mutex_);
  next_stream_ = stream;
  if (cancelled_) stream->cancel();
  return stream;
}

/// With send_mutex_. Throws `cause` if nothing can be done about it.
void SessionStream::recover(const Error& cause) {
  const auto give_up = [this](const Error& error) {
    const std::lock_guard lock(mutex_);
    over_ = error;
    throw error;
  };
  {
    const std::lock_guard lock(mutex_);
    if (!resumable_ || cancelled_ || cause.code() != ErrorCode::kUnavailable) throw cause;
  }
  const auto deadline = Clock::now() + options_.patience;
  std::string last = cause.what();
  for (auto pause = kFirstPause;; pause = std::min(2 * pause, kLongestPause)) {
    try {
      if (options_.away) options_.away();
      reopen(std::max(left_until(deadline), kFirstPause));
      return;
    } catch (const Error& error) {
      if (error.code() != ErrorCode::kUnavailable && error.code() != ErrorCode::kDeadlineExceeded) give_up(error);
      last = error.what();
    }
    std::unique_lock lock(mutex_);
    if (changed_.wait_for(lock, pause, [this] { return cancelled_; })) {
      lock.unlock();
      give_up(Error(ErrorCode::kCancelled, options_.stream.peer + ": cancelled"));
    }
    lock.unlock();
    if (Clock::now() >= deadline) {
      give_up(Error(ErrorCode::kUnavailable,
                    last + "; not back after " + std::to_string(options_.patience.count()) + " ms"));
    }
  }
}

/// With send_mutex_. Another thread may still take answers from the old stream: they count, and the new stream's
/// answers to the same frames are dropped.
void SessionStream::reopen(std::chrono::milliseconds left) {
  std::vector<const v1::EnhanceRequest*> frames;
  std::uint64_t again = 0;  // frames of the session that the new stream has answered, or need not
  {
    const std::lock_guard lock(mutex_);
    resending_ = true;
    again = checkpointed_;
    open_.mutable_open()->set_checkpoint(checkpoint_);
    for (const Kept& kept : kept_) frames.push_back(kept.request.get());
  }
  const std::shared_ptr<void> settle(nullptr, [this](void*) {
    const std::lock_guard lock(mutex_);
    resending_ = false;
    note(later_checkpoint_, later_frames_);
  });
  const auto stream = make_stream(std::min(left, options_.stream.open_timeout));
  const v1::EnhanceOpened opened = stream->open(open_);
  if (opened.fine().hash() != opened_.fine().hash()) {
    throw Error(ErrorCode::kFailedPrecondition, options_.stream.peer + " came back with another fine mesh; begin anew");
  }
  v1::EnhanceResponse dropped;
  for (std::size_t sent = 0;;) {
    while (sent < frames.size() && stream->try_push(*frames[sent])) ++sent;
    {
      std::unique_lock lock(mutex_);
      if (again >= answered_) {
        if (sent == frames.size()) {
          stream_ = stream;
          next_stream_.reset();
          ++generation_;
          changed_.notify_all();
          if (cancelled_) stream->cancel();
          break;
        }
        // The answer that makes room is on its way out of the old stream.
        changed_.wait_for(lock, std::chrono::milliseconds(1));
        continue;
      }
    }
    if (!stream->pop(&dropped)) throw Error(ErrorCode::kUnavailable, options_.stream.peer + " ended the session");
    ++again;
    const std::lock_guard lock(mutex_);
    note(dropped.checkpoint(), again);
  }
  if (closed_) stream->close();
}

}  // namespace pleat::client
