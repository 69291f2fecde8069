// `pleat bridge`: a live session over standard input and output.
#include <atomic>
#include <condition_variable>
#include <cstdio>
#include <deque>
#include <iostream>
#include <mutex>
#include <thread>

#include "common/base/scratch_folder.hpp"
#include "common/base/signals.hpp"
#include "common/base/version.hpp"
#include "common/client/cpp/client.hpp"
#include "services/cli/bridge.hpp"
#include "services/cli/command.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/cli/output.hpp"

namespace pleat::cli {
namespace {

using nlohmann::json;

struct Options {
  std::string model, detail, coordinator, logs;
  rpc::TlsOptions tls;
};

/// The lines of standard input, read by a thread of its own: "cancel" is heard while frames are made.
class Lines {
 public:
  Lines() : thread_([this] { read(); }) {}
  /// The thread may wait for a line that never comes: it is left to the end of the process.
  ~Lines() { thread_.detach(); }

  /// The next line; nothing after "quit" and at the end. Waits at most `timeout`: then an empty line.
  std::optional<std::string> next(std::chrono::milliseconds timeout) {
    std::unique_lock lock(state_->mutex);
    state_->changed.wait_for(lock, timeout, [this] { return !state_->lines.empty() || state_->over; });
    if (state_->lines.empty()) return state_->over ? std::nullopt : std::optional<std::string>("");
    std::string line = std::move(state_->lines.front());
    state_->lines.pop_front();
    return line;
  }

  /// Whether a cancel has come; forgets it.
  bool take_cancel() { return state_->cancelled.exchange(false); }
  bool cancelled() const { return state_->cancelled; }

 private:
  struct State {
    std::mutex mutex;
    std::condition_variable changed;
    std::deque<std::string> lines;
    bool over = false;
    std::atomic<bool> cancelled{false};
  };

  void read() const {
    const std::shared_ptr<State> state = state_;
    for (std::string line; std::getline(std::cin, line);) {
      const json request = json::parse(line, nullptr, false);
      const std::lock_guard lock(state->mutex);
      if (request.is_object() && request.contains("quit")) break;
      if (request.is_object() && request.contains("cancel")) {
        state->lines.clear();  // what was asked for before goes with it
        state->cancelled = true;
        state->lines.push_back(line);
      } else {
        state->lines.push_back(line);
      }
      state->changed.notify_all();
    }
    const std::lock_guard lock(state->mutex);
    state->over = true;
    state->changed.notify_all();
  }

  std::shared_ptr<State> state_ = std::make_shared<State>();
  std::thread thread_;
};

void say(const json& answer) {
  std::printf("%s\n", answer.dump().c_str());
  std::fflush(stdout);
}

int bridge(Options options) {
  const v1::Detail detail = choose_detail(options.detail, options.model);
  ModelChoice model{options.model, {}};
  std::optional<ScratchFolder> work;
  std::optional<Launcher> launcher;
  std::string address = options.coordinator;
  if (address.empty()) {
    if (uses_network(detail)) model = choose_model(options.model);
    work.emplace(std::filesystem::temp_directory_path(), "pleat-bridge");
    LauncherOptions launch;
    launch.models = model.folder;
    launch.model = model.name;
    launch.network = uses_network(detail);
    launch.fold = uses_fold(detail);
    launch.data = work->path();
    launch.logs = options.logs.empty() ? work->path() / "logs" : std::filesystem::path(options.logs);
    launcher.emplace(launch);
    address = launcher->coordinator();
  }
  const client::Client client(address, options.tls);
  client.wait_ready(std::chrono::seconds(30));
  Bridge bridge(client, {model.name, launcher ? detail : detail_named(options.detail)});
  Lines lines;
  say({{"ready", {{"version", version()}, {"coordinator", address}}}});
  while (!interrupted()) {
    if (launcher) {
      for (const std::string& line : launcher->supervise()) std::fprintf(stderr, "%s\n", line.c_str());
    }
    const std::optional<std::string> line = lines.next(std::chrono::milliseconds(200));
    if (!line) break;
    if (line->empty()) continue;
    try {
      const json request = json::parse(*line, nullptr, false);
      if (request.is_discarded()) throw_invalid_argument("not JSON: " + *line);
      if (request.is_object() && request.contains("cancel")) {
        lines.take_cancel();
        say({{"cancelled", json::object()}});
        continue;
      }
      bridge.answer(request, say, [&] {
        if (launcher) {
          for (const std::string& text : launcher->supervise()) std::fprintf(stderr, "%s\n", text.c_str());
        }
        return interrupted() || lines.cancelled();
      });
    } catch (const Error& error) {
      if (error.code() != ErrorCode::kCancelled)
        say({{"error", {{"code", to_string(error.code())}, {"message", error.what()}}}});
    }
  }
  if (launcher) launcher->stop();
  return kExitDone;
}

}  // namespace

std::vector<Command> add_bridge(CLI::App& root) {
  CLI::App* app = root.add_subcommand("bridge", "a live session for other programs: JSON lines, frames in PC2 files");
  const auto options = std::make_shared<Options>();
  app->add_option("--model", options->model, "model bundle: a file, or a name in deploy/models");
  add_detail_option(*app, options->detail);
  app->add_option("--coordinator", options->coordinator,
                  "address of a running coordinator (default: start all services for this session)");
  app->add_option("--logs", options->logs, "folder for the services' logs (default: none are kept)");
  add_tls_options(*app, options->tls);
  return {{app, [options] { return bridge(*options); }}};
}

}  // namespace pleat::cli
