// The client of a coordinator's public API, for programs in C++ and for the command `pleat`: jobs and live sessions in
// plain values and typed errors. docs/client.md has a complete program.
//
//   pleat::client::Client client("unix:/run/pleat/coordinator.sock");
//   pleat::client::EnhanceSession session = client.enhance({.coarse = garment});
//   session.push(frame);                        // a coarse frame; blocks while the window is full
//   while (auto fine = session.pop()) { ... }   // enhanced frames in order, until close()
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/client/cpp/job_watcher.hpp"
#include "common/client/cpp/values.hpp"
#include "common/rpc/channel.hpp"
#include "pleat/v1/coordinator.pb.h"

namespace pleat::client {

struct EnhanceOptions {
  Mesh coarse;             ///< with material coordinates
  std::string model = {};  ///< bundle; empty: the coordinator's default
  double frame_time_s = 0.04;
  std::vector<ObstacleShape> obstacles = {};
  std::optional<float> clearance_m = {};
  std::uint32_t window = 0;  ///< frames in flight, at most 64; 0: 4
  bool skip_refinement = false;
  std::optional<std::uint32_t> subdivision_rounds = {};  ///< unset: the coordinator's default
  v1::Detail detail = v1::DETAIL_UNSPECIFIED;  ///< network, fold step or both; unset: the coordinator's default
  std::string material_json = {};        ///< for the fold step, ARCSim's format; empty: the shipped default material
  std::vector<std::uint32_t> held = {};  ///< for the fold step: coarse vertices that the cloth is held at all the time
  std::array<double, 3> wind_m_s = {};   ///< for the fold step
  /// How long the coordinator may stay away in the middle of the session, which then goes on where it was, with the
  /// same bits. 0: a session ends with its coordinator.
  std::chrono::milliseconds patience{30'000};
  std::function<void()> away = {};  ///< called now and then while it is away; what it throws ends the session
};

/// What a session works with.
struct SessionInfo {
  Mesh fine;                                    ///< of the answers
  std::vector<std::uint32_t> feature_vertices;  ///< (V_coarse) the coarse vertices inside the fine mesh
  std::string model, device, precision;
  v1::Detail detail = v1::DETAIL_NETWORK;  ///< what is in force
};

/// A live session. One thread may push while another pops; with a single thread use run() or try_push(). Failures of
/// the session as a whole throw pleat::Error with the coordinator's address; afterwards all members throw it.
class EnhanceSession {
 public:
  EnhanceSession(EnhanceSession&&) noexcept;
  EnhanceSession& operator=(EnhanceSession&&) noexcept;
  ~EnhanceSession();

  const SessionInfo& info() const;

  /// Sends a frame; blocks while the window is full.
  void push(const CoarseFrame& frame);
  /// The same without blocking; false: the window is full.
  bool try_push(const CoarseFrame& frame);
  /// The next answer, in the order of the frames; blocks. Nothing: the session was closed and everything has come.
  std::optional<EnhancedFrame> pop();
  /// No more frames will be pushed.
  void close();
  /// From any thread. Later calls throw kCancelled.
  void cancel();

  using Input = std::function<CoarseFrame(std::uint64_t index)>;
  using Sink = std::function<void(const EnhancedFrame& answer, const CoarseFrame& input)>;
  /// Sends frames 0 to count - 1 as the window allows, in this thread, and gives every answer with its input to `sink`,
  /// those with an error too. Closes the session: call it once. Throws what input or sink throw (frames in flight are
  /// lost), kUnavailable if the coordinator ends early.
  void run(std::uint64_t count, const Input& input, const Sink& sink);

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
  /// Connects at the first call. An address that is not local needs TLS, else kInvalidArgument. kNotFound or
  /// kInvalidArgument for a file of `tls` that is not what it should be.
  /// traceparent: of the caller's W3C trace context, "00-TRACE-SPAN-FLAGS". Every call carries it, and the log lines of
  /// all services that work on it have its trace id. Empty: the coordinator makes one for each call; kInvalidArgument
  /// if it is not valid.
  explicit Client(std::string address, const rpc::TlsOptions& tls = {}, const std::string& traceparent = {});
  ~Client();
  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;

  const std::string& address() const;
  /// Waits until the coordinator serves. Throws kUnavailable after `timeout`.
  void wait_ready(std::chrono::milliseconds timeout) const;

  /// An empty job_id is replaced by the scene's name and random digits, so that the call may be repeated when the
  /// connection breaks (it is, up to three times) and still makes one job.
  v1::Job create_job(v1::CreateJobRequest request) const;
  v1::Job get_job(const std::string& id) const;
  v1::Job cancel_job(const std::string& id) const;
  /// One that has ended, with its files. A repeated call may find it gone: kNotFound.
  v1::Job remove_job(const std::string& id) const;
  /// Those that the caller may read, newest first; before them, if asked for, the live sessions, as jobs that run.
  std::vector<v1::Job> list_jobs(bool live_sessions = false) const;

  /// Follows a job from a thread of its own, which calls the sinks.
  JobWatcher watch_job(const std::string& id, JobSinks sinks = {}, const JobWatchOptions& options = {}) const;

  EnhanceSession enhance(const EnhanceOptions& options) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::client
