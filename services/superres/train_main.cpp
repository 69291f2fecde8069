// pleat-train CONFIG: trains a model bundle (docs/training.md).
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <string>

#include "common/base/error.hpp"
#include "services/superres/training/trainer.hpp"

namespace {

std::atomic<bool> stop_requested{false};

constexpr const char* kUsage =
    "usage: pleat-train CONFIG\n"
    "Trains a model bundle as the JSON file CONFIG says (docs/training.md), or goes on from its check-point.\n"
    "Ctrl-C ends the training after the step at hand, with a check-point. Exit: 0 done, 1 failed, 2 wrong usage or "
    "input.\n";

int exit_code(pleat::ErrorCode code) {
  const bool input = code == pleat::ErrorCode::kInvalidArgument || code == pleat::ErrorCode::kNotFound ||
                     code == pleat::ErrorCode::kFailedPrecondition || code == pleat::ErrorCode::kDataLoss;
  return input ? 2 : 1;
}

void run(const std::string& path) {
  using namespace pleat::superres;
  const TrainConfig config = read_train_config(path);
  const bool terminal = ::isatty(STDOUT_FILENO) == 1;
  TrainHooks hooks;
  hooks.git_revision = PLEAT_GIT_REVISION;
  hooks.stop = &stop_requested;
  hooks.line = [terminal](const std::string& line) {
    std::printf("%s%s\n", terminal ? "\r\033[K" : "", line.c_str());
    std::fflush(stdout);
  };
  if (terminal) {
    hooks.progress = [](int epoch, double fraction, double loss) {
      const int filled = static_cast<int>(30 * fraction);
      std::printf("\r\033[Kepoch %d [%-30s] %3.0f %%  loss %.3e", epoch, std::string(filled, '#').c_str(),
                  100 * fraction, loss);
      std::fflush(stdout);
    };
  }
  const LoadedPairs pairs = load_pairs(config, hooks.line);
  const TrainResult result = train(config, pairs.data, pairs.judge.get(), hooks);
  const char* reasons[] = {"all epochs done", "time is up", "stopped on request"};
  hooks.line(std::string(reasons[static_cast<int>(result.reason)]) +
             (result.bundle.empty() ? "" : "; best bundle: " + result.bundle));
}

}  // namespace

int main(int argc, char** argv) {
  const std::string first = argc == 2 ? argv[1] : "";
  if (first == "--help" || first == "-h") return std::fputs(kUsage, stdout) < 0 ? 1 : 0;
  if (argc != 2) return std::fputs(kUsage, stderr), 2;
  std::signal(SIGINT, [](int) { stop_requested = true; });
  std::signal(SIGTERM, [](int) { stop_requested = true; });
  try {
    run(first);
    return 0;
  } catch (const pleat::Error& error) {
    std::fprintf(stderr, "pleat-train: %s: %s\n", std::string(to_string(error.code())).c_str(), error.what());
    return exit_code(error.code());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "pleat-train: %s\n", error.what());
    return 1;
  }
}
