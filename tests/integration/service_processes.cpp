#include "tests/integration/service_processes.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>

#include "common/base/error.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::testing {
namespace {

using namespace std::chrono_literals;

/// A TCP connection on loopback.
class LoopbackSocket {
 public:
  LoopbackSocket() : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {}
  ~LoopbackSocket() { ::close(fd_); }
  LoopbackSocket(const LoopbackSocket&) = delete;
  LoopbackSocket& operator=(const LoopbackSocket&) = delete;

  static sockaddr_in place(int port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
  }
  /// A free port below those that the system gives to outgoing connections: it stays free while a service starts.
  static int free_port() {
    static int next = 12'000 + ::getpid() % 20'000;
    for (; next < 32'768; ++next) {
      const LoopbackSocket probe;
      sockaddr_in address = place(next);
      if (::bind(probe.fd_, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0) return next++;
    }
    throw_internal("no free port");
  }
  std::string http_get(int port, const std::string& path) {
    sockaddr_in address = place(port);
    if (::connect(fd_, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) return {};
    const std::string request = "GET " + path + " HTTP/1.0\r\n\r\n";
    if (::send(fd_, request.data(), request.size(), MSG_NOSIGNAL) < 0) return {};
    std::string answer;
    char buffer[4096];
    for (ssize_t count = 0; (count = ::recv(fd_, buffer, sizeof buffer, 0)) > 0;) {
      answer.append(buffer, static_cast<std::size_t>(count));
    }
    return answer;
  }

 private:
  int fd_;
};

std::string health_name(const std::string& service) {
  if (service == "simulation") return "pleat.v1.Simulation";
  if (service == "conversion") return "pleat.v1.Conversion";
  if (service == "superres") return "pleat.v1.SuperResolution";
  if (service == "refinement") return "pleat.v1.Refinement";
  return "pleat.v1.Coordinator";
}

std::filesystem::path environment_path(const char* name) {
  const char* value = std::getenv(name);
  if (value == nullptr) throw_not_found(std::string("the environment lacks ") + name);
  return value;
}

}  // namespace

const std::vector<std::string>& ServiceProcesses::stages() {
  static const std::vector<std::string> names{"simulation", "conversion", "superres", "refinement"};
  return names;
}

ServiceProcesses::ServiceProcesses() : executables_(environment_path("PLEAT_BINARY_DIR") / "bin") {
  const char* other_models = std::getenv("PLEAT_MODELS");
  const std::filesystem::path models =
      other_models != nullptr ? other_models : environment_path("PLEAT_SOURCE_DIR") / "deploy" / "models";
  std::map<std::string, std::string> links;
  for (const std::string& stage : stages()) {
    arguments_[stage] = {"--listen", address(stage), "--die-with-parent"};
    // The other three tell by their sessions whether a client has left everything.
    if (stage != "superres") {
      metrics_ports_[stage] = LoopbackSocket::free_port();
      arguments_[stage].insert(arguments_[stage].end(),
                               {"--metrics-listen", "127.0.0.1:" + std::to_string(metrics_ports_[stage])});
    }
    links[stage] = address(stage);
  }
  arguments_["superres"].insert(arguments_["superres"].end(), {"--models", models.string()});
  for (const std::string& stage : stages()) start(stage);
  for (const std::string& stage : stages()) wait_until_healthy(stage);
  start_coordinator("coordinator", links);
}

void ServiceProcesses::start(const std::string& service) {
  const bool coordinator = health_name(service) == "pleat.v1.Coordinator";
  running_.insert_or_assign(service,
                            cli::ChildProcess(executables_ / (coordinator ? "pleat-coordinator" : "pleat-" + service),
                                              arguments_.at(service), folder_.path() / (service + ".log")));
}

void ServiceProcesses::wait_until_healthy(const std::string& service) {
  const auto deadline = std::chrono::steady_clock::now() + 180s;
  const auto channel = rpc::create_channel(address(service));
  while (!rpc::is_healthy(channel, health_name(service), 200ms)) {
    if (!running_.at(service).running() || std::chrono::steady_clock::now() > deadline) {
      throw Error(ErrorCode::kUnavailable, service + " does not start: " + log(service));
    }
    ::usleep(20'000);
  }
}

void ServiceProcesses::kill(const std::string& service) {
  running_.at(service).send(SIGKILL);
  running_.at(service).wait_until(std::chrono::steady_clock::now() + 10s);
}

std::string ServiceProcesses::terminate(const std::string& service) {
  running_.at(service).send(SIGTERM);
  running_.at(service).wait_until(std::chrono::steady_clock::now() + 20s);
  return running_.at(service).end_reason();
}

void ServiceProcesses::start_coordinator(const std::string& name, const std::map<std::string, std::string>& options) {
  arguments_[name] = {"--listen", address(name), "--die-with-parent", "--data",
                      (folder_.path() / (name + "-data")).string()};
  for (const auto& [option, value] : options) arguments_[name].insert(arguments_[name].end(), {"--" + option, value});
  start(name);
  wait_until_healthy(name);
}

std::unique_ptr<v1::Coordinator::Stub> ServiceProcesses::client(const std::string& coordinator) const {
  return v1::Coordinator::NewStub(rpc::create_channel(address(coordinator)));
}

std::string ServiceProcesses::address(const std::string& service) const {
  return "unix:" + (folder_.path() / (service + ".sock")).string();
}

double ServiceProcesses::metric(const std::string& service, const std::string& name_and_labels) const {
  const auto port = metrics_ports_.find(service);
  if (port == metrics_ports_.end()) return -1;
  const std::string page = LoopbackSocket().http_get(port->second, "/metrics");
  const auto place = page.find("\n" + name_and_labels + " ");
  return place == std::string::npos ? -1 : std::strtod(page.c_str() + place + name_and_labels.size() + 2, nullptr);
}

std::string ServiceProcesses::log(const std::string& service) const {
  return cli::last_lines(folder_.path() / (service + ".log"), 5);
}

}  // namespace pleat::testing
