#include "services/superres/training/program.hpp"

#include <sys/prctl.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/program.hpp"
#include "services/superres/bundle/any_mesh.hpp"
#include "services/superres/bundle/re_export.hpp"
#include "services/superres/training/followers.hpp"
#include "services/superres/training/initial.hpp"
#include "services/superres/training/rendezvous.hpp"
#include "services/superres/training/trainer.hpp"

namespace pleat::superres {
namespace {

constexpr int kBarWidth = 30;

TrainHooks hooks_of(const TrainArguments& arguments) {
  const bool first = arguments.rank == 0;
  const bool terminal = first && ::isatty(STDOUT_FILENO) == 1;
  TrainHooks hooks;
  hooks.git_revision = arguments.git_revision;
  hooks.stop = arguments.stop;
  hooks.rank = arguments.rank;
  hooks.processes = arguments.processes;
  hooks.rendezvous = arguments.rendezvous;
  hooks.line = [terminal, first](const std::string& line) {
    if (!first) return;
    std::printf("%s%s\n", terminal ? "\r\033[K" : "", line.c_str());
    std::fflush(stdout);
  };
  if (terminal) {
    hooks.progress = [](int epoch, double fraction, double loss) {
      const std::string filled(static_cast<std::size_t>(kBarWidth * fraction), '#');
      std::printf("\r\033[Kepoch %d [%-*s] %3.0f %%  loss %.3e", epoch, kBarWidth, filled.c_str(), 100 * fraction,
                  loss);
      std::fflush(stdout);
    };
  }
  return hooks;
}

/// Longer than any conversion of a data set, which the first process does before it listens.
constexpr std::chrono::hours kMeeting{12};

std::atomic<bool> stop_requested{false};

void rewrite(const TrainArguments& arguments) {
  if (!arguments.any_mesh.empty()) return serve_any_mesh(arguments.any_mesh, arguments.garment, arguments.out);
  if (!arguments.garment.empty()) return add_rest_mesh(arguments.re_export, arguments.garment, arguments.out);
  re_export(arguments.re_export, arguments.out);
}

int train_here(const TrainArguments& arguments) {
  std::vector<std::string> changes;
  if (!arguments.initial.empty()) changes = changes_to_begin_with(arguments.initial);
  changes.insert(changes.end(), arguments.changes.begin(), arguments.changes.end());
  const TrainConfig config = read_train_config(arguments.config, changes);
  TrainHooks hooks = hooks_of(arguments);
  const bool distributed = is_distributed(arguments);
  // The first process converts the images; the others find them in files.
  if (distributed && arguments.rank > 0) {
    await_listener(*parse_rendezvous(arguments.rendezvous), kMeeting, arguments.stop);
  }
  const LoadedPairs pairs =
      load_pairs(config, hooks.line, [&] { return arguments.stop != nullptr && arguments.stop->load(); });
  std::optional<Followers> followers;
  if (!distributed && arguments.rank == 0 && arguments.processes > 1) {
    std::filesystem::create_directories(config.output);
    hooks.rendezvous = config.output + "/rendezvous." + std::to_string(::getpid());
    followers.emplace(arguments.words, arguments.processes, hooks.rendezvous);
  }
  const TrainResult result = train(config, pairs.data, pairs.judge.get(), hooks);
  if (followers) {
    followers->done();
    followers.reset();
    std::error_code ignored;
    std::filesystem::remove(hooks.rendezvous, ignored);
  }
  const char* reasons[] = {"all epochs done", "time is up", "stopped on request"};
  hooks.line(std::string(reasons[static_cast<int>(result.reason)]) +
             (result.bundle.empty() ? "" : "; best bundle: " + result.bundle));
  return distributed && result.reason == StopReason::kStopped ? kExitRunAgain : kExitDone;
}

}  // namespace

bool is_distributed(const TrainArguments& arguments) { return parse_rendezvous(arguments.rendezvous).has_value(); }

std::atomic<bool>* stop_on_signals(const TrainArguments& arguments) {
  if (arguments.rank == 0) {
    std::signal(SIGINT, [](int) { stop_requested = true; });
    std::signal(SIGTERM, [](int) { stop_requested = true; });
    return &stop_requested;
  }
  // Ctrl-C and batch systems reach all processes; the first one decides when all stop.
  std::signal(SIGINT, SIG_IGN);
  if (is_distributed(arguments)) {
    std::signal(SIGTERM, SIG_IGN);
  } else {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  }
  return &stop_requested;
}

int run_training(const TrainArguments& arguments) {
  if (!arguments.re_export.empty() && !arguments.any_mesh.empty()) {
    throw_invalid_argument("--re-export and --any-mesh don't go together");
  }
  const bool rewrites = !arguments.re_export.empty() || !arguments.any_mesh.empty();
  if (rewrites == arguments.out.empty()) {
    throw_invalid_argument("--re-export or --any-mesh OLD.pt and --out NEW.pt go together");
  }
  if (rewrites ? !arguments.any_mesh.empty() && arguments.garment.empty() : !arguments.garment.empty()) {
    throw_invalid_argument("--garment MESH goes with --any-mesh, which needs it, and with --re-export");
  }
  if (rewrites) {
    rewrite(arguments);
    return kExitDone;
  }
  if (arguments.config.empty()) throw_invalid_argument("no configuration; see pleat-train --help");
  try {
    return train_here(arguments);
  } catch (const Error& error) {
    // The others' check-point is where the next run goes on.
    if (!is_distributed(arguments) || error.code() != ErrorCode::kUnavailable) throw;
    print_error("pleat-train", error.what());
    return kExitRunAgain;
  }
}

}  // namespace pleat::superres
