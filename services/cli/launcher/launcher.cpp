#include "services/cli/launcher/launcher.hpp"

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <thread>

#include "common/base/error.hpp"
#include "common/base/signals.hpp"
#include "common/base/terminal.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kHealthTimeout{300};
constexpr std::chrono::milliseconds kPoll{20};
constexpr std::chrono::milliseconds kCoordinatorHeadStart{500};
constexpr std::chrono::milliseconds kFirstPause{500}, kLongestPause{30'000};

/// Before a service that has ended `ends` times in the last minute is started again.
std::chrono::milliseconds pause_after(std::size_t ends) {
  if (ends <= 1) return std::chrono::milliseconds(0);
  return std::min(kLongestPause, kFirstPause * (1 << std::min<std::size_t>(ends - 2, 10)));
}

// A service that ended is back after the pause and its start, which takes half a minute on a busy machine.
constexpr const char* kGiveUp = "120";

constexpr const char* kDefaultBundle = "draping";

struct Known {
  const char* name;
  const char* health_name;
};
// The coordinator is last: it starts when its stages are about to listen.
constexpr Known kServices[] = {{"simulation", "pleat.v1.Simulation"},    {"conversion", "pleat.v1.Conversion"},
                               {"superres", "pleat.v1.SuperResolution"}, {"fold", "pleat.v1.Fold"},
                               {"refinement", "pleat.v1.Refinement"},    {"coordinator", "pleat.v1.Coordinator"}};

/// The bundle that superres loads at its start; "" where there is none.
std::string default_bundle(const fs::path& models) {
  std::vector<std::string> names;
  std::error_code ignored;
  for (const fs::directory_entry& entry : fs::directory_iterator(models, ignored))
    // A training's folder has its check-point beside the bundle.
    if (entry.path().extension() == ".pt" && entry.path().stem() != "checkpoint")
      names.push_back(entry.path().stem().string());
  std::sort(names.begin(), names.end());
  if (std::find(names.begin(), names.end(), kDefaultBundle) != names.end()) return kDefaultBundle;
  return names.empty() ? "" : names.front();
}

/// The address behind "ready " in a log, where the system chose the port.
std::optional<std::string> ready_address(const fs::path& log, std::streamoff from) {
  std::ifstream stream(log);
  stream.seekg(from);
  for (std::string line; std::getline(stream, line);)
    if (line.starts_with("ready ")) return line.substr(6);
  return std::nullopt;
}

}  // namespace

struct Launcher::Running {
  ChildProcess process;
  fs::path log;
  std::streamoff log_start = 0;
  std::vector<Clock::time_point> ends;   ///< in the last minute
  std::optional<Clock::time_point> due;  ///< it has ended, and is started again then
};

fs::path default_models_folder() {
  if (const char* models = std::getenv("PLEAT_MODELS"); models != nullptr && *models != '\0') return models;
  return shipped_file("models");
}

Launcher::Launcher(LauncherOptions options) : options_(std::move(options)), liveness_(options_.patience) {
  if (options_.models.empty()) options_.models = default_models_folder();
  if (options_.model.empty()) options_.model = default_bundle(options_.models);
  std::error_code failed;
  for (const fs::path& folder : {options_.data, options_.logs}) {
    fs::create_directories(folder, failed);
    if (failed) throw_invalid_argument(folder.string() + ": can't be made: " + failed.message());
  }
  for (const Known& known : kServices) {
    Service service;
    service.name = known.name;
    if (!options_.network && (service.name == "conversion" || service.name == "superres")) continue;
    if (!options_.fold && service.name == "fold") continue;
    service.health_name = known.health_name;
    service.address = "unix:" + (sockets_.path() / (service.name + ".sock")).string();
    if (service.name == "coordinator" && !options_.listen.empty()) service.address = options_.listen;
    services_.push_back(service);
    begin_log(options_.logs / (service.name + ".log"), "pleat-" + service.name);
  }
  running_.reserve(services_.size());
  for (std::size_t i = 0; i < services_.size(); ++i) start_service(i);
  wait_until_healthy();
}

Launcher::~Launcher() { stop(); }

const std::string& Launcher::coordinator() const { return services_.back().address; }

void Launcher::start_service(std::size_t index) {
  Service& service = services_[index];
  std::vector<std::string> arguments{"--listen", service.address, "--die-with-parent"};
  const auto add = [&arguments](const std::string& flag, const std::string& value) {
    arguments.push_back(flag);
    arguments.push_back(value);
  };
  if (service.name == "superres") {
    add("--models", options_.models.string());
    add("--model", options_.model);
  }
  if (service.name == "coordinator") {
    for (std::size_t i = 0; i < index; ++i) add("--" + services_[i].name, services_[i].address);
    add("--data", options_.data.string());
    add("--give-up-s", kGiveUp);
    arguments.emplace_back(options_.shared ? "--jobs-yield=true" : "--jobs-yield=false");
    if (!options_.metrics_listen.empty()) add("--metrics-listen", options_.metrics_listen);
    if (!options_.token_file.empty()) add("--token-file", options_.token_file);
  }
  const fs::path log = options_.logs / (service.name + ".log");
  std::error_code ignored;
  const auto size = fs::file_size(log, ignored);
  ChildProcess child(options_.executables / ("pleat-" + service.name), arguments, log);
  service.pid = child.pid();
  say("pleat-" + service.name + ": process " + std::to_string(service.pid) + " at " + service.address + ", log " +
      log.string());
  const std::streamoff log_start = ignored ? 0 : static_cast<std::streamoff>(size);
  if (index < running_.size()) {
    running_[index].process = std::move(child);
    running_[index].log_start = log_start;
  } else {
    running_.push_back({std::move(child), log, log_start, {}, std::nullopt});
  }
}

void Launcher::wait_until_healthy() {
  const Clock::time_point deadline = Clock::now() + options_.start_timeout;
  for (std::size_t i = 0; i < services_.size(); ++i) {
    Service& service = services_[i];
    const bool port_unknown = service.address.ends_with(":0");
    std::shared_ptr<grpc::Channel> channel;
    while (true) {
      if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted while the services were starting");
      for (std::size_t k = 0; k < running_.size(); ++k) {
        if (!running_[k].process.running()) throw Error(ErrorCode::kUnavailable, cause_of_end(k));
      }
      if (!channel) {
        if (port_unknown) {
          if (const auto address = ready_address(running_[i].log, running_[i].log_start)) service.address = *address;
        }
        if (!service.address.ends_with(":0")) channel = rpc::create_channel(service.address);
      }
      if (channel && rpc::is_healthy(channel, service.health_name, kHealthTimeout)) {
        liveness_.watch(service.name, service.health_name, service.address, options_.patience);
        say("pleat-" + service.name + " serves");
        break;
      }
      if (Clock::now() >= deadline)
        throw Error(ErrorCode::kUnavailable, service.name + " at " + service.address + " is not healthy after " +
                                                 std::to_string(options_.start_timeout.count()) +
                                                 " s (log: " + running_[i].log.string() + ")");
      std::this_thread::sleep_for(kPoll);
    }
  }
}

std::string Launcher::cause_of_end(std::size_t index) const {
  const Running& running = running_[index];
  const std::string last = last_lines(running.log, 1);
  return services_[index].name + " ended (" + running.process.end_reason() +
         "): " + (last.empty() ? "it wrote nothing" : last) + " (log: " + running.log.string() + ")";
}

std::vector<std::string> Launcher::supervise() {
  std::vector<std::string> lines;
  for (std::size_t i = 0; i < running_.size(); ++i) {
    Running& running = running_[i];
    const Service& service = services_[i];
    std::string cause;
    if (running.process.running()) {
      if (!liveness_.hangs(service.name)) continue;
      cause = " does not answer";
      running.process.send(SIGKILL);
      running.process.wait_until(Clock::now() + std::chrono::seconds(5));
    }
    const Clock::time_point now = Clock::now();
    if (!running.due) {
      liveness_.forget(service.name);
      std::erase_if(running.ends, [now](Clock::time_point t) { return now - t > std::chrono::minutes(1); });
      running.ends.push_back(now);
      const auto pause = pause_after(running.ends.size());
      running.due = now + pause;
      if (cause.empty()) cause = " ended (" + running.process.end_reason() + ")";
      lines.push_back(service.name + cause + " and is started again" +
                      (pause.count() == 0 ? "" : " in " + std::to_string(pause.count()) + " ms"));
    }
    if (now < *running.due) continue;
    running.due.reset();
    start_service(i);
    liveness_.watch(service.name, service.health_name, service.address, options_.start_timeout);
  }
  return lines;
}

void Launcher::stop() {
  if (running_.empty()) return;
  for (const Service& service : services_) liveness_.forget(service.name);
  // The coordinator first, so that it ends its streams before its stages go.
  const Clock::time_point deadline = Clock::now() + options_.stop_grace;
  running_.back().process.send(SIGTERM);
  running_.back().process.wait_until(std::min(deadline, Clock::now() + kCoordinatorHeadStart));
  // A second SIGTERM would end the coordinator at once.
  for (std::size_t i = 0; i + 1 < running_.size(); ++i) running_[i].process.send(SIGTERM);
  for (Running& running : running_) running.process.wait_until(deadline);
  running_.clear();  // kills what is left
}

}  // namespace pleat::cli
