// Metrics of a service: Prometheus names with units, one endpoint a process.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

namespace pleat::telemetry {

/// The figures of one process. All members are thread-safe.
///   pleat_stage_latency_seconds{service,stage}   histogram, 0.25 ms to 1 s
///   pleat_frames_total{service,stage,result}     counter; result is ok or error
///   pleat_sessions{service}                      gauge of open streams
///   pleat_inflight_frames{service,stage}         gauge
///   pleat_window_frames{service,stage}           gauge: how many may be in flight, where there is a window
///   pleat_queue_depth{service,edge}              gauge: frames or jobs that wait
///   pleat_NAME_total{service}                    by count(), for what only one service has
class Metrics {
 public:
  explicit Metrics(const std::string& service);
  ~Metrics();
  Metrics(const Metrics&) = delete;
  Metrics& operator=(const Metrics&) = delete;

  /// Serves http://ADDRESS/metrics. Throws kUnavailable if the address is taken, kInvalidArgument if it is not local
  /// and `anywhere` was not asked for: the page is plain text, readable by whoever reaches it.
  void serve(const std::string& address, bool anywhere = false);

  void frame_done(const std::string& stage, double seconds, bool ok);
  void add_sessions(int delta);
  int sessions() const;
  std::uint64_t ended_sessions() const;
  void add_inflight(const std::string& stage, int delta);
  void add_window(const std::string& stage, int delta);
  void set_queue_depth(const std::string& edge, std::size_t depth);
  void count(const std::string& name, double amount = 1);

  /// The page as served; for tests.
  std::string text() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::telemetry
