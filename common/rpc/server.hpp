// Runs gRPC services in a process: addresses, limits, health, signals, draining.
#pragma once

#include <grpcpp/impl/service_type.h>

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/config/options.hpp"
#include "common/rpc/channel.hpp"
#include "common/telemetry/log.hpp"
#include "common/telemetry/metrics.hpp"

namespace pleat::rpc {

struct ServerOptions {
  /// "unix:PATH" or "HOST:PORT"; port 0 lets the system choose. Anything but a local address needs `tls`.
  std::string listen;
  TlsOptions tls;
  /// Reflection, for grpcurl and the like.
  bool reflection = true;
  /// Prometheus endpoint "127.0.0.1:PORT"; empty: none.
  std::string metrics_listen;
  /// Allows a metrics address beyond loopback: inside a container, where only the published port counts.
  bool metrics_anywhere = false;
  /// Calls that still run this long after the first signal are cancelled.
  double drain_s = 5;
  /// Threads that gRPC may use for calls in flight: the bound on sessions.
  int max_threads = 256;
  /// Ends the process when the one that started it ends, however that ends.
  bool die_with_parent = false;
  telemetry::LogOptions log;
};

/// Adds the flags of ServerOptions: --listen, --metrics-listen, --metrics-anywhere, --tls-ca, --tls-certificate,
/// --tls-key, --tls-crl, --reflection, --drain-s, --max-threads, --die-with-parent, --log-level, --log-format.
void add_options(config::Options& options, ServerOptions& server);

/// A service with its full name ("pleat.v1.Refinement"), which is what health checks ask for.
struct HostedService {
  grpc::Service* service = nullptr;
  std::string name;
  /// Called once when stopping begins; should make long calls end soon. May be empty.
  std::function<void()> drain = {};
  /// Whether there is room for more work, as the health of NAME.room tells: not of NAME itself, because who does not
  /// serve is replaced. May be empty.
  std::function<bool()> has_room = {};
};

/// A running server; for tests and for processes with a life of their own. Services must outlive it.
class Server {
 public:
  /// Listens and serves. Throws kInvalidArgument (address, TLS files), kUnavailable (address in use; it is named).
  /// A socket file that nobody listens on is removed first.
  /// sessions: how many calls are worth waiting for when it stops; empty: unknown, it waits for whoever is connected.
  Server(const ServerOptions& options, const std::vector<HostedService>& services, std::function<int()> sessions = {});
  /// Stops.
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// The address for clients, with the chosen port.
  const std::string& address() const;

  /// Asks the services whether they have room; NAME.room is SERVING if so. To be called now and then.
  void show_room();

  /// Health to NOT_SERVING and drain callbacks; then sessions have `drain_s` to end, if `sessions` is there to count
  /// them; then everything is cancelled. A client that only keeps its connection costs no time. Idempotent.
  void stop();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Serves until SIGTERM or SIGINT, then drains; a second signal ends the process at once with 128 + its number. Prints
/// "ready ADDRESS" on stdout when healthy. Returns 0. Call inside service_main only, which blocks the signals in time.
int run_server(const ServerOptions& options, const std::vector<HostedService>& services, telemetry::Metrics& metrics);

/// The frame of every service's main(): blocks SIGTERM, SIGINT and SIGPIPE before any thread exists, keeps freed memory
/// for the next frame, runs the body, and turns exceptions into one line on stderr and an exit code: 2 for wrong usage
/// or input, 1 otherwise.
int service_main(const std::string& program, const std::function<int()>& body);

}  // namespace pleat::rpc
