// Coordinator.Enhance: coarse frames in, refined fine frames out, live.
#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/limits.hpp"
#include "pleat/v1/coordinator.pb.h"
#include "services/coordinator/blocking_reactor.hpp"
#include "services/coordinator/client_quota.hpp"
#include "services/coordinator/pipeline.hpp"
#include "services/coordinator/session_feed.hpp"

namespace pleat::coordinator {

struct LiveSettings {
  std::size_t max_sessions = 32;
  std::size_t max_sessions_each = 0;                    ///< of one caller; 0: as many as all together
  double open_timeout_s = 10;                           ///< for the client's first message
  double idle_timeout_s = 300;                          ///< for its next frame
  double reader_timeout_s = 30;                         ///< for it to take an answer
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the fine mesh of a session or job
  double max_live_gb = 8;                               ///< frames in flight of all sessions, 10^9 bytes
};

/// Ids of live sessions begin so; those of jobs have no colon.
inline constexpr std::string_view kLivePrefix = "live:";

/// All live sessions of a coordinator; each has a thread that reads, and the pipeline's own. Thread-safe.
class LiveSessions {
 public:
  using Reactor = BlockingReactor<v1::EnhanceRequest, v1::EnhanceResponse>;

  LiveSessions(ServiceAddresses addresses, LinkOptions link, LiveSettings settings);
  /// Waits until the last session has ended; call drain() and stop the server first.
  ~LiveSessions();

  /// The handler of one call. client: whose limits count; trace: what its work belongs to.
  Reactor* start(grpc::CallbackServerContext* context, const std::string& client, const telemetry::TraceContext& trace);

  /// Whether another session would be admitted.
  bool has_room() const;

  /// What there is to see of the sessions that run, newest first.
  std::vector<std::shared_ptr<SessionFeed>> feeds() const;
  /// Throws kNotFound if there is no such session any more.
  std::shared_ptr<SessionFeed> feed(const std::string& id) const;

  /// Sessions take no further frame, answer those in flight, and end with UNAVAILABLE; new ones are refused.
  void drain();

 private:
  class Session;
  class Share;

  const ServiceAddresses addresses_;
  const LinkOptions link_;
  const LiveSettings settings_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  double admitted_bytes_ = 0;  ///< of frames in flight
  std::set<std::shared_ptr<Session>> sessions_;
  std::size_t started_ = 0;
  ClientQuota quota_;
  bool draining_ = false;
};

}  // namespace pleat::coordinator
