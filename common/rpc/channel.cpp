#include "common/rpc/channel.hpp"

#include <absl/synchronization/mutex.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/security/credentials.h>

#include <algorithm>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/runtime_folder.hpp"
#include "common/rpc/certificates.hpp"
#include "common/rpc/frame_bytes.hpp"
#include "health.grpc.pb.h"

namespace pleat::rpc {

bool is_unix_address(const std::string& address) {
  return address.starts_with("unix:") || address.starts_with("unix-abstract:");
}

bool is_local_address(const std::string& address) {
  if (is_unix_address(address)) return true;
  const std::string host = address.substr(0, address.rfind(':'));
  if (host == "localhost" || host == "[::1]") return true;
  return host.rfind("127.", 0) == 0 && host.find_first_not_of("0123456789.") == std::string::npos;
}

void keep_grpc() {
  // Debian's Abseil looks for deadlocks among its mutexes, whenever gRPC locks one.
  absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore);
  // A channel that stays for ever, with one call made on it.
  struct Keeper {
    std::shared_ptr<grpc::Channel> channel = grpc::CreateChannel("unix:/dev/null", grpc::InsecureChannelCredentials());
    std::unique_ptr<grpc::health::v1::Health::Stub> stub = grpc::health::v1::Health::NewStub(channel);
    grpc::ClientContext context;
    grpc::health::v1::HealthCheckRequest request;
    grpc::health::v1::HealthCheckResponse response;
  };
  [[maybe_unused]] static Keeper* const keeper = [] {
    auto* made = new Keeper;
    made->stub->async()->Check(&made->context, &made->request, &made->response, [](const grpc::Status&) {});
    return made;
  }();
}

std::shared_ptr<grpc::Channel> create_channel(const std::string& address, const TlsOptions& tls) {
  if (address.empty()) throw_invalid_argument("an empty address");
  keep_grpc();
  std::shared_ptr<grpc::ChannelCredentials> credentials;
  grpc::ChannelArguments arguments;
  if (tls.enabled()) {
    credentials = channel_credentials(tls);
    if (!tls.server_name.empty()) arguments.SetSslTargetNameOverride(tls.server_name);
  } else {
    if (!is_local_address(address)) throw_invalid_argument("address " + address + " is not local and needs TLS");
    if (address.starts_with("unix:")) check_runtime_folder(address.substr(5), false);
    credentials = grpc::InsecureChannelCredentials();
  }
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetMaxSendMessageSize(kMaxMessageBytes);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_FRAME_SIZE, kHttp2FrameBytes);
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 30'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 0);
  // One connection per channel: gRPC would otherwise share it, and a connection is about one core.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  // A service that comes back is found within a second.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  // Not a pause, in spite of its name: how long an attempt may take. A busy machine needs a while to accept.
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 5000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  return grpc::CreateCustomChannel(address, credentials, arguments);
}

namespace {

/// Empty when SERVING, otherwise what is wrong.
std::string health_problem(const std::shared_ptr<grpc::Channel>& channel, const std::string& service,
                           std::chrono::system_clock::time_point deadline) {
  grpc::ClientContext context;
  context.set_deadline(deadline);
  grpc::health::v1::HealthCheckRequest request;
  request.set_service(service);
  grpc::health::v1::HealthCheckResponse response;
  const grpc::Status status = grpc::health::v1::Health::NewStub(channel)->Check(&context, request, &response);
  if (status.error_code() == grpc::StatusCode::NOT_FOUND) return "the process there has no such service";
  if (!status.ok()) return status.error_message();
  if (response.status() != grpc::health::v1::HealthCheckResponse::SERVING) return "it says NOT_SERVING";
  return "";
}

}  // namespace

bool is_healthy(const std::shared_ptr<grpc::Channel>& channel, const std::string& service,
                std::chrono::milliseconds timeout) {
  return health_problem(channel, service, std::chrono::system_clock::now() + timeout).empty();
}

void wait_healthy(const std::shared_ptr<grpc::Channel>& channel, const std::string& service, const std::string& address,
                  std::chrono::milliseconds timeout) {
  using namespace std::chrono_literals;
  const auto end = std::chrono::system_clock::now() + timeout;
  while (true) {
    const std::string problem = health_problem(channel, service, std::min(end, std::chrono::system_clock::now() + 2s));
    if (problem.empty()) return;
    if (std::chrono::system_clock::now() + 20ms >= end) {
      throw Error(ErrorCode::kUnavailable, service + " at " + address + " is not serving: " + problem);
    }
    std::this_thread::sleep_for(20ms);
  }
}

}  // namespace pleat::rpc
