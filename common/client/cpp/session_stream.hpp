// The stream of a live session that outlives its coordinator.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/rpc/stream.hpp"
#include "pleat/v1/coordinator.pb.h"

namespace pleat::client {

/// Frames go to a coordinator and their answers come back. When the coordinator goes away (killed, restarted,
/// replaced), the session is opened again behind the newest checkpoint that came with an answer, and the frames since
/// then are sent again; what was answered before is dropped, so that the user gets every answer once, in order, with
/// the bits that it would have had. One thread may push while another pops. Errors as rpc::FrameStream.
class SessionStream {
 public:
  using Request = std::unique_ptr<v1::EnhanceRequest>;
  using Stream = rpc::FrameStream<v1::EnhanceRequest, v1::EnhanceResponse>;

  struct Options {
    rpc::FrameStreamOptions stream;
    std::chrono::milliseconds patience{30'000};  ///< how long the coordinator may stay away; 0: not at all
    std::function<void()> away = {};             ///< called now and then meanwhile; what it throws ends the session
  };

  /// Opens the session; nothing is tried twice here. open: with `open` in it, without checkpoints.
  SessionStream(Stream::Starter start, Options options, v1::EnhanceRequest open);

  const v1::EnhanceOpened& opened() const { return opened_; }

  /// An empty request to be filled, with the memory of one that was sent.
  Request spare();
  /// Blocks while the window is full, and while the coordinator is away.
  void push(Request request);
  /// Takes the request unless the window is full.
  bool try_push(Request& request);
  /// The next answer. False: closed, and all have come.
  bool pop(v1::EnhanceResponse* response);
  void close();
  /// From any thread.
  void cancel();

 private:
  struct Kept {
    std::uint64_t sequence = 0;
    Request request;
  };
  struct Current {
    std::shared_ptr<Stream> stream;
    std::uint64_t generation = 0;
  };

  Current current();
  bool lock_unless_replaced(std::unique_lock<std::mutex>& sending, std::uint64_t generation);
  bool send(Request& request, bool wait);
  void keep(Request request);
  void note(const std::string& checkpoint, std::uint64_t frames);
  void recover(const Error& cause);
  void reopen(std::chrono::milliseconds left);
  std::shared_ptr<Stream> make_stream(std::chrono::milliseconds open_timeout);
  void throw_if_over();

  const Stream::Starter start_;
  const Options options_;
  v1::EnhanceRequest open_;
  v1::EnhanceOpened opened_;
  std::mutex send_mutex_;  ///< who sends or recovers; before mutex_
  std::mutex mutex_;
  std::condition_variable changed_;
  std::shared_ptr<Stream> stream_;
  std::shared_ptr<Stream> next_stream_;  ///< while it is being opened
  std::uint64_t generation_ = 0;         ///< of stream_; answers of an older one don't count
  bool resumable_;
  std::deque<Kept> kept_;           ///< since the checkpoint
  std::uint64_t pushed_ = 0;        ///< frames of the session
  std::uint64_t answered_ = 0;      ///< frames that the user has the answers of
  std::string checkpoint_;          ///< the newest; empty: none yet
  std::uint64_t checkpointed_ = 0;  ///< frames before it
  bool resending_ = false;          ///< a newer checkpoint waits in the next two
  std::string later_checkpoint_;
  std::uint64_t later_frames_ = 0;
  bool closed_ = false, cancelled_ = false;
  std::optional<Error> over_;  ///< the coordinator stayed away
  std::vector<Request> spare_;
};

}  // namespace pleat::client
