#include "tests/integration/service_processes.hpp"

#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "common/base/error.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::testing {
namespace {

using namespace std::chrono_literals;

/// The stage whose name a process has or begins with; else it is a coordinator.
std::string kind_of(const std::string& service) {
  for (const std::string& stage : ServiceProcesses::stages()) {
    if (service == stage || service.starts_with(stage + "-")) return stage;
  }
  return "coordinator";
}

std::string health_name(const std::string& service) {
  const std::string kind = kind_of(service);
  if (kind == "simulation") return "pleat.v1.Simulation";
  if (kind == "conversion") return "pleat.v1.Conversion";
  if (kind == "superres") return "pleat.v1.SuperResolution";
  if (kind == "fold") return "pleat.v1.Fold";
  if (kind == "refinement") return "pleat.v1.Refinement";
  return "pleat.v1.Coordinator";
}

std::filesystem::path environment_path(const char* name) {
  const char* value = std::getenv(name);
  if (value == nullptr) throw_not_found(std::string("the environment lacks ") + name);
  return value;
}

}  // namespace

const std::vector<std::string>& ServiceProcesses::stages() {
  static const std::vector<std::string> names{"simulation", "conversion", "superres", "fold", "refinement"};
  return names;
}

ServiceProcesses::ServiceProcesses() : executables_(environment_path("PLEAT_BINARY_DIR") / "bin") {
  const char* other_models = std::getenv("PLEAT_MODELS");
  const std::filesystem::path models =
      other_models != nullptr ? other_models : environment_path("PLEAT_SOURCE_DIR") / "deploy" / "models";
  std::map<std::string, std::string> links;
  for (const std::string& stage : stages()) {
    arguments_[stage] = {"--listen", address(stage), "--die-with-parent"};
    links[stage] = address(stage);
  }
  arguments_["superres"].insert(arguments_["superres"].end(), {"--models", models.string()});
  for (const std::string& stage : stages()) start(stage);
  for (const std::string& stage : stages()) wait_until_healthy(stage);
  start_coordinator("coordinator", links);
}

void ServiceProcesses::start(const std::string& service) {
  running_.insert_or_assign(service, ChildProcess(executables_ / ("pleat-" + kind_of(service)), arguments_.at(service),
                                                  folder_.path() / (service + ".log")));
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

bool ServiceProcesses::kill_within_job(const std::string& service, const std::string& job) {
  kill(service);
  bool unfinished = false;
  if (service == "coordinator") {
    unfinished = std::filesystem::exists(folder_.path() / "coordinator-data" / "jobs" / job / "result.h5.partial");
  } else {
    grpc::ClientContext context;
    v1::GetJobRequest request;
    request.set_id(job);
    v1::Job state;
    unfinished = client()->GetJob(&context, request, &state).ok() && state.state() == v1::Job::STATE_RUNNING;
  }
  start(service);
  wait_until_healthy(service);
  return unfinished;
}

std::string ServiceProcesses::terminate(const std::string& service) {
  running_.at(service).send(SIGTERM);
  running_.at(service).wait_until(std::chrono::steady_clock::now() + 20s);
  return running_.at(service).end_reason();
}

void ServiceProcesses::start_replica(const std::string& name) {
  arguments_[name] = arguments_.at(kind_of(name));
  arguments_[name][1] = address(name);  // of --listen
  arguments_[name].insert(arguments_[name].end(), {"--drain-s", "600"});
  start(name);
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

int ServiceProcesses::connections(const std::string& service) const {
  // Columns: Num RefCount Protocol Flags Type St Inode Path; state 03 is a connection, 01 the listening socket.
  const std::string path = address(service).substr(std::string("unix:").size());
  std::ifstream table("/proc/net/unix");
  int count = 0;
  for (std::string line; std::getline(table, line);) {
    std::istringstream columns(line);
    std::string column, state, place;
    for (int i = 0; i < 5; ++i) columns >> column;
    columns >> state >> column >> place;
    count += state == "03" && place == path ? 1 : 0;
  }
  return count;
}

std::string ServiceProcesses::log(const std::string& service) const {
  return last_lines(folder_.path() / (service + ".log"), 5);
}

std::string ServiceProcesses::whole_log(const std::string& service) const {
  std::ostringstream text;
  text << std::ifstream(folder_.path() / (service + ".log")).rdbuf();
  return text.str();
}

}  // namespace pleat::testing
