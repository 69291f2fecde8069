// Bidirectional frame streams as the wire contract has them: `open` answered by `opened`, then frames, answered in
// order, each by a frame or a FrameError. All is bounded by the window, and messages are reused, so that a long session
// does not allocate per frame. As few threads as can be hand a frame to each other: waking one up costs as much as
// copying a fine mesh. Between processes of one host the frames go through shared memory (shared_frames.hpp).
#pragma once

#include <grpcpp/grpcpp.h>
#include <grpcpp/support/client_callback.h>
#include <grpcpp/support/sync_stream.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

#include "common/rpc/drain.hpp"
#include "common/rpc/end_mark.hpp"
#include "common/rpc/priority.hpp"
#include "common/rpc/shared_frames.hpp"
#include "common/rpc/status.hpp"
#include "common/rpc/trace.hpp"
#include "common/telemetry/metrics.hpp"
#include "common/telemetry/stage_timer.hpp"

namespace pleat::rpc {

inline constexpr std::uint32_t kDefaultWindow = 4;
inline constexpr std::uint32_t kMaxWindow = 64;

/// A client that owes a message (a frame, an acknowledgement) and is silent this long is cut off.
inline constexpr std::chrono::seconds kIdleTimeout{600};
/// A client that does not take an answer this long is cut off.
inline constexpr std::chrono::seconds kReaderTimeout{60};

/// The window of an `open` message: 0 means kDefaultWindow; more than kMaxWindow is kInvalidArgument.
std::uint32_t checked_window(std::uint32_t requested);

/// The frame index of a message: its own, or that of its coarse or fine frame.
template <typename Message>
std::uint64_t frame_index(const Message& message) {
  if constexpr (requires { message.index(); }) {
    return message.index();
  } else if constexpr (requires { message.coarse().index(); }) {
    return message.coarse().index();
  } else {
    return message.fine().index();
  }
}

struct FrameServiceOptions {
  std::string stage;                      ///< in metrics, and in the answer's stage_times where it has them
  telemetry::Metrics* metrics = nullptr;  ///< may be null
  Drain* drain = nullptr;                 ///< of the service; may be null
  std::size_t concurrency = 1;            ///< frames of one stream processed at the same time
  std::chrono::milliseconds idle_timeout = kIdleTimeout;      ///< without a frame while none is in work
  std::chrono::milliseconds reader_timeout = kReaderTimeout;  ///< for one answer to be taken
};

/// The memory that a client on this host offers for its frames, if it does and it can be had; the client is told with
/// the first answer. To be called before that, with the stream's window.
std::unique_ptr<SharedFrames> accept_shared_frames(grpc::ServerContextBase& context, std::uint32_t window);

/// A whole handler of a frame stream, to be returned from the service's method.
///   open(const OpenMessage&, OpenedMessage*) -> process
///   process(const RequestFrame&, ResponseFrame*), or process(const Request&, ResponseFrame*) for the whole message
/// An exception of `open` ends the stream with its status; one of `process` becomes a FrameError and the stream goes
/// on. With concurrency > 1, process is called from several threads at once; answers keep the order of the requests. A
/// broken sequence of messages (no open, a second one, bytes that are no message) ends the stream with INVALID_ARGUMENT
/// after the frames before.
/// All of it runs in a TraceScope of the call, and with the priority that the call asks for.
/// When the service drains, the frames that were read are answered and the stream ends with UNAVAILABLE, as a new one
/// does; through a connection that waits for the client, which can't be told of it otherwise, as a call that was
/// cancelled. Frames that were not read are for the client to send to another replica.
/// A client that is silent, or does not read, ends with DEADLINE_EXCEEDED after the time-outs of the options.
template <typename Request, typename Response, typename Open>
grpc::Status serve_frames(grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream,
                          const FrameServiceOptions& options, Open&& open);

/// Server side of streams that the server drives and the client paces by acknowledging (Simulation.Simulate).
/// Request needs has_ack_index() and ack_index(). Construct after `open` was read; it reads from then on.
template <typename Request, typename Response>
class PacedWriter {
 public:
  /// drain: of the service; may be null.
  PacedWriter(grpc::ServerContext* context, grpc::ServerReaderWriter<Response, Request>* stream, std::uint32_t window,
              std::uint64_t next_index, Drain* drain = nullptr);
  /// Cancels the call if the client still sends; joins the reader. Call close() first for a normal end.
  ~PacedWriter();

  /// Waits until `index` is inside the window, then writes. False: the client has gone, or closed its side. Throws
  /// kUnavailable when the service drains and the frame is not inside yet, kInvalidArgument if it sent what is no
  /// acknowledgement, kDeadlineExceeded if it sends none.
  bool write(std::uint64_t index, const Response& response);

  /// True once the client has gone, closed its side, or sent what is no acknowledgement: stop working.
  bool stopped() const;

  /// Waits until the client closes its side or has gone. After the last frame. Throws as write().
  void close();

 private:
  void read();
  void throw_if_broken() const;

  grpc::ServerContext* context_;
  grpc::ServerReaderWriter<Response, Request>* stream_;
  std::uint32_t window_;
  std::uint64_t acknowledged_;  ///< frames below this index have been taken
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool stopped_ = false, broken_ = false, draining_ = false;
  const Drain::Watch drain_watch_;
  std::thread reader_;
};

struct FrameStreamOptions {
  std::string peer;                                  ///< for messages: "refinement at unix:/run/pleat/refinement.sock"
  std::uint32_t window = kDefaultWindow;             ///< frames in flight; as sent in `open`
  std::chrono::milliseconds open_timeout{60'000};    ///< until `opened`
  std::chrono::milliseconds frame_timeout{120'000};  ///< longest wait for an answer while frames are in flight
  bool server_driven = false;                        ///< answers come without requests; the timeout always applies
  bool same_host = false;                            ///< offers shared memory for the frames; for a Unix socket
};

/// Client side of a frame stream. One thread may push while another pops; with a single thread use try_push.
/// All members throw pleat::Error with the peer's name when the stream has failed: what the service said, kUnavailable
/// if it went away, kDeadlineExceeded if it gave no sign for a time-out, kCancelled after cancel().
///
/// No member waits longer than the time-outs for the peer, writes included, and none waits after cancel(). gRPC itself
/// may: a write to a process that is stopped completes when that process ends. So the call is gRPC's own; a stream that
/// has failed leaves it behind.
template <typename Request, typename Response>
class FrameStream {
 public:
  using Reactor = grpc::ClientBidiReactor<Request, Response>;
  using Starter = std::function<void(grpc::ClientContext*, Reactor*)>;

  /// start: [&](auto* context, auto* call) { stub->async()->Refine(context, call); }
  FrameStream(const Starter& start, FrameStreamOptions options);
  /// Cancels what is still running.
  ~FrameStream();
  FrameStream(const FrameStream&) = delete;
  FrameStream& operator=(const FrameStream&) = delete;

  /// Sends `open` and returns `opened`. First call.
  auto open(const Request& request);

  /// Sends a frame; blocks while the window is full, or the peer has not taken the one before. The request may be
  /// changed or freed when it returns. That the peer did not get it is told by the next call, here or in pop().
  void push(const Request& request);
  /// Sends a frame unless the window is full.
  bool try_push(const Request& request);
  /// Sends a message that is not a frame and gets no answer (an acknowledgement).
  void send(const Request& request);

  /// The next answer (a frame or a FrameError), blocking. False: the stream has ended well.
  bool pop(Response* response);

  /// No more frames will be pushed.
  void close();
  /// From any thread. Later calls throw kCancelled.
  void cancel();

  std::uint32_t in_flight() const;
  /// Whether frames go through shared memory; known after open().
  bool shares_memory() const;

 private:
  using Clock = std::chrono::steady_clock;
  using Lock = std::unique_lock<std::mutex>;
  class Call;

  bool write(const Request& request, bool counted, bool wait);
  [[noreturn]] void throw_write_failure(Lock& lock);
  void throw_if_ending(Lock& lock);
  bool read(Lock& lock, Response* response);
  bool read_call(Lock& lock, Response* response);
  bool read_shared(Lock& lock, Response* response);
  Error undecodable_answer() const;
  template <typename Done>
  bool wait_for_peer(Lock& lock, std::condition_variable& changed, Clock::time_point since, Done done,
                     const SharedFrames* bell = nullptr);
  void take_status(Lock& lock);
  void fail(Lock& lock, const Error& error);
  void throw_if_ended_badly() const;

  FrameStreamOptions options_;
  std::shared_ptr<Call> call_;
  std::mutex write_mutex_;  ///< one write at a time, and close() not before it ended
  std::uint32_t in_flight_ = 0;
  bool opened_ = false, closed_ = false, ended_ = false, reading_ = false;
  Clock::time_point last_sign_ = Clock::now();  ///< when the peer last answered, or was last asked
  Clock::time_point write_since_{};             ///< when the write began that is not through
  std::optional<Error> error_;
};

}  // namespace pleat::rpc

#include "common/rpc/frame_stream.ipp"
#include "common/rpc/served_stream.ipp"
