#include "common/rpc/server.hpp"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <mutex>
#include <thread>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/exit_codes.hpp"
#include "common/base/freed_memory.hpp"
#include "common/base/runtime_folder.hpp"
#include "common/rpc/certificates.hpp"
#include "common/rpc/frame_bytes.hpp"

namespace pleat::rpc {
namespace {

sigset_t stop_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  return signals;
}

/// Removes the socket file that a killed server of this user left behind. Throws kUnavailable if somebody listens on
/// it, or if that can't be told; kInvalidArgument for what is no socket, or another user's.
void clear_socket(const std::string& path) {
  struct stat there {};
  if (::lstat(path.c_str(), &there) != 0) return;
  if (!S_ISSOCK(there.st_mode)) throw_invalid_argument(path + ": exists and is no socket");
  if (there.st_uid != ::geteuid()) throw_invalid_argument(path + ": is a socket of another user");
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  std::strncpy(name.sun_path, path.c_str(), sizeof(name.sun_path) - 1);
  const int probe = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool answered = probe >= 0 && connect(probe, reinterpret_cast<const sockaddr*>(&name), sizeof(name)) == 0;
  // A full queue, or a socket of another kind, is somebody's too.
  const bool abandoned = probe >= 0 && !answered && errno == ECONNREFUSED;
  if (probe >= 0) close(probe);
  if (!abandoned) throw Error(ErrorCode::kUnavailable, "address unix:" + path + " is in use by another process");
  ::unlink(path.c_str());
}

std::string socket_path(const std::string& address) {
  if (address.rfind("unix:", 0) != 0) return "";
  std::string path = address.substr(5);
  if (path.rfind("//", 0) == 0) path.erase(0, 2);  // unix:///absolute
  return path;
}

std::shared_ptr<grpc::ServerCredentials> credentials_of(const ServerOptions& options) {
  if (!options.tls.enabled()) {
    if (!is_local_address(options.listen)) {
      throw_invalid_argument("listen address " + options.listen +
                             " is not local: it needs --tls-ca, --tls-certificate " + "and --tls-key");
    }
    return grpc::InsecureServerCredentials();
  }
  return server_credentials(options.tls);
}

/// Gives back the memory that ended sessions have left, every few seconds.
class SessionLeftovers {
 public:
  explicit SessionLeftovers(const telemetry::Metrics& metrics) : metrics_(metrics) {}

  void give_back() {
    const auto now = std::chrono::steady_clock::now();
    const std::uint64_t ended = metrics_.ended_sessions();
    if (ended == given_back_ || now - last_ < kInterval) return;
    give_back_holes();
    given_back_ = ended;
    last_ = now;
  }

 private:
  static constexpr std::chrono::seconds kInterval{5};
  const telemetry::Metrics& metrics_;
  std::uint64_t given_back_ = 0;
  std::chrono::steady_clock::time_point last_;
};

}  // namespace

void add_options(config::Options& options, ServerOptions& server) {
  options.add("listen", server.listen, "address: unix:PATH or HOST:PORT; not local needs the three TLS files")
      .add("tls-ca", server.tls.ca_file, "PEM file of the authority that signs clients' certificates")
      .add("tls-certificate", server.tls.certificate_file, "PEM file of this service's certificate")
      .add("tls-key", server.tls.key_file, "PEM file of its key")
      .add("tls-crl", server.tls.crl_file, "PEM file of the certificates that the authority has revoked")
      .add("reflection", server.reflection, "offer gRPC reflection")
      .add("metrics-listen", server.metrics_listen, "Prometheus endpoint 127.0.0.1:PORT; empty: none")
      .add("metrics-anywhere", server.metrics_anywhere, "allow a metrics address beyond loopback (containers)")
      .add("drain-s", server.drain_s, "seconds that calls may take to end after the first signal")
      .add("max-threads", server.max_threads, "threads for calls in flight")
      .add("die-with-parent", server.die_with_parent, "end when the process that started this one ends")
      .add("log-level", server.log.level, "trace, debug, info, warn, error, off")
      .add("log-format", server.log.format, "console or json");
}

struct Server::State {
  std::vector<HostedService> services;
  std::string address;
  double drain_s = 0;
  std::function<int()> sessions;
  std::unique_ptr<grpc::Server> server;
  std::once_flag stopped;
};

Server::Server(const ServerOptions& options, const std::vector<HostedService>& services, std::function<int()> sessions)
    : state_(std::make_unique<State>()) {
  keep_grpc();
  state_->sessions = std::move(sessions);
  if (options.listen.empty()) throw_invalid_argument("no listen address");
  if (options.max_threads < 4) throw_invalid_argument("max-threads: at least 4");
  const std::string path = socket_path(options.listen);
  if (!path.empty()) {
    if (path.size() >= sizeof(sockaddr_un::sun_path)) {
      throw_invalid_argument("socket path " + path + " is longer than " +
                             std::to_string(sizeof(sockaddr_un::sun_path) - 1) + " characters");
    }
    check_runtime_folder(path, true);
    std::error_code error;  // a folder that can't be made is reported by listening
    std::filesystem::create_directories(std::filesystem::path(path).parent_path(), error);
    clear_socket(path);
  }
  static std::once_flag plugins;
  std::call_once(plugins, [] { grpc::EnableDefaultHealthCheckService(true); });
  if (options.reflection) {
    static std::once_flag reflection;
    std::call_once(reflection, [] { grpc::reflection::InitProtoReflectionServerBuilderPlugin(); });
  }

  grpc::ServerBuilder builder;
  int port = 0;
  builder.AddListeningPort(options.listen, credentials_of(options), &port);
  builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
  builder.SetMaxSendMessageSize(kMaxMessageBytes);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MAX_FRAME_SIZE, kHttp2FrameBytes);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);  // a port that is taken is an error, not shared
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 15'000);
  // A client whose host is gone, or that says nothing at all, leaves its connection; they are asked and closed.
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, 600'000);
  grpc::ResourceQuota quota("pleat");
  quota.SetMaxThreads(options.max_threads);
  builder.SetResourceQuota(quota);
  for (const HostedService& hosted : services) builder.RegisterService(hosted.service);
  state_->server = builder.BuildAndStart();
  if (state_->server == nullptr) {
    throw Error(ErrorCode::kUnavailable,
                "can't listen on " + options.listen + ": the address is in use or not allowed");
  }
  state_->services = services;
  state_->drain_s = options.drain_s;
  state_->address = options.listen;
  const std::size_t colon = options.listen.rfind(':');
  if (path.empty() && colon != std::string::npos && options.listen.substr(colon) == ":0") {
    state_->address = options.listen.substr(0, colon + 1) + std::to_string(port);
  }
  for (const HostedService& hosted : services) {
    state_->server->GetHealthCheckService()->SetServingStatus(hosted.name, true);
  }
  show_room();
}

Server::~Server() { stop(); }

const std::string& Server::address() const { return state_->address; }

void Server::show_room() {
  for (const HostedService& hosted : state_->services) {
    if (!hosted.has_room) continue;
    state_->server->GetHealthCheckService()->SetServingStatus(hosted.name + ".room", hosted.has_room());
  }
}

void Server::stop() {
  std::call_once(state_->stopped, [&] {
    if (state_->server == nullptr) return;
    state_->server->GetHealthCheckService()->SetServingStatus(false);
    for (const HostedService& hosted : state_->services) {
      if (hosted.drain) hosted.drain();
    }
    using Clock = std::chrono::system_clock;
    constexpr auto kLastAnswers = std::chrono::milliseconds(100);  // for unary calls, and statuses on their way
    const auto end =
        Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(state_->drain_s));
    if (state_->sessions) {
      while (state_->sessions() > 0 && Clock::now() < end) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    state_->server->Shutdown(state_->sessions ? std::min<Clock::time_point>(end, Clock::now() + kLastAnswers) : end);
    state_->server->Wait();  // removes the socket file too
  });
}

int run_server(const ServerOptions& options, const std::vector<HostedService>& services, telemetry::Metrics& metrics) {
  if (options.die_with_parent) {
    // The kernel sends it when the thread that started this process ends.
    const pid_t parent = getppid();
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) throw Error(ErrorCode::kCancelled, "the parent process has ended");
  }
  if (!options.metrics_listen.empty()) metrics.serve(options.metrics_listen, options.metrics_anywhere);
  Server server(options, services, [&metrics] { return metrics.sessions(); });
  spdlog::info("serving at {}", server.address());
  std::printf("ready %s\n", server.address().c_str());
  std::fflush(stdout);

  const sigset_t signals = stop_signals();
  constexpr timespec kRoomInterval{0, 250'000'000};
  int signal = 0;
  SessionLeftovers leftovers(metrics);
  while ((signal = sigtimedwait(&signals, nullptr, &kRoomInterval)) < 0) {
    server.show_room();
    leftovers.give_back();
  }
  spdlog::info("{}: draining for at most {} s", strsignal(signal), options.drain_s);
  std::thread impatient([signals, limit = static_cast<time_t>(options.drain_s) + 10] {
    // A second signal, or a handler that ignores being cancelled, ends the process without further ado.
    const timespec timeout{limit, 0};
    const int second = sigtimedwait(&signals, nullptr, &timeout);
    _exit(second > 0 ? 128 + second : 1);
  });
  impatient.detach();
  server.stop();
  spdlog::info("stopped");
  spdlog::default_logger()->flush();
  return 0;
}

int service_main(const std::string& program, const std::function<int()>& body) {
  const sigset_t signals = stop_signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  keep_freed_memory();
  // gRPC prints failures on stderr that come back as statuses anyway; one line per failure is ours.
  setenv("GRPC_VERBOSITY", "NONE", 0);
  try {
    return body();
  } catch (const Error& error) {
    std::fprintf(stderr, "%s: %s\n", program.c_str(), error.what());
    return exit_code(error.code());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", program.c_str(), error.what());
    return kExitFailed;
  }
}

}  // namespace pleat::rpc
