// The C++ SDK: the coordinator's public API in values and typed errors.
//
//   pleat::Client client("unix:/run/pleat/coordinator.sock");
//   pleat::EnhanceSession session = client.enhance({.coarse = garment});
//   session.push(frame);                        // a coarse frame; blocks while the window is full
//   while (auto fine = session.pop()) { ... }   // enhanced frames in order, until close()
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/frame/frame.hpp"
#include "common/rpc/channel.hpp"
#include "pleat/v1/coordinator.pb.h"

namespace pleat {

struct EnhanceOptions {
  Topology coarse;         ///< with material coordinates
  std::string model = {};  ///< empty: the coordinator's default
  double frame_time_s = 0.04;
  std::vector<ObstacleShape> obstacles = {};
  std::optional<float> clearance_m = {};
  std::uint32_t window = 4;  ///< frames in flight, 1 to 64
  bool skip_refinement = false;
  std::uint32_t subdivision_rounds = 2;
};

/// One answer of a session: a fine frame, or why there is none. The session goes on either way.
struct EnhancedResult {
  std::uint64_t index = 0;
  Frame fine;  ///< empty if `error` is set
  v1::RefinementReport report;
  std::vector<v1::StageTime> stage_times;
  std::optional<Error> error;
};

/// A live session. One thread may push while another pops. Failures of the session as a whole throw pleat::Error with
/// the coordinator's address; afterwards all members throw it.
class EnhanceSession {
 public:
  EnhanceSession(EnhanceSession&&) noexcept;
  EnhanceSession& operator=(EnhanceSession&&) noexcept;
  ~EnhanceSession();

  /// The fine mesh of the answers, and what the coordinator uses.
  const Topology& fine() const;
  const v1::EnhanceOpened& opened() const;

  /// Sends a frame. Velocities may be empty: the coordinator takes differences. Blocks while the window is full.
  void push(const Frame& coarse, const std::vector<ObstacleFrame>& obstacles = {});
  /// The same without blocking; false: the window is full.
  bool try_push(const Frame& coarse, const std::vector<ObstacleFrame>& obstacles = {});
  /// The next answer, in the order of the frames; blocks. Nothing: the session was closed and everything has come.
  std::optional<EnhancedResult> pop();
  /// No more frames will be pushed.
  void close();
  void cancel();

 private:
  friend class Client;
  struct State;
  explicit EnhanceSession(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// A connection to a coordinator. Thread-safe. Every call throws pleat::Error with the address in its message:
/// kUnavailable if nobody answers, kDeadlineExceeded, and what the coordinator says.
class Client {
 public:
  explicit Client(std::string address, const rpc::TlsOptions& tls = {});
  ~Client();
  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;

  const std::string& address() const;
  /// Waits until the coordinator serves. Throws kUnavailable after `timeout`.
  void wait_ready(std::chrono::milliseconds timeout) const;

  /// An empty job_id is replaced by a random one, so that the call may be repeated when the connection breaks (it is,
  /// up to three times) and still makes one job.
  v1::Job create_job(v1::CreateJobRequest request) const;
  v1::Job get_job(const std::string& id) const;
  v1::Job cancel_job(const std::string& id) const;
  std::vector<v1::Job> list_jobs() const;

  /// Calls `on_event` for every event until the job has ended (true), or `on_event` returns false (false).
  bool watch_job(const std::string& id, std::uint64_t from_index, bool include_frames,
                 const std::function<bool(const v1::JobEvent&)>& on_event) const;

  EnhanceSession enhance(const EnhanceOptions& options) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat
