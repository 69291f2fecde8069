// pleat-train CONFIG: trains a model bundle (docs/training.md).
#include <fcntl.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "services/superres/training/trainer.hpp"

namespace {

std::atomic<bool> stop_requested{false};

constexpr const char* kUsage =
    "usage: pleat-train CONFIG [--set KEY=VALUE]... [--strict] [--processes N]\n"
    "Trains a model bundle as the JSON file CONFIG says (docs/training.md), or goes on from its check-point.\n"
    "  --set KEY=VALUE   changes a key of CONFIG, for example losses.normal=0 or output=out/train/mine\n"
    "  --strict          a sequence that can't be used is an error, not a warning\n"
    "  --processes N     data-parallel training by N processes on this host\n"
    "Ctrl-C ends the training after the step at hand, with a check-point. Exit: 0 done, 1 failed, 2 wrong usage or "
    "input.\n";

struct Arguments {
  std::string config;
  std::vector<std::string> changes;
  int processes = 1;
  int rank = 0;            ///< of a process that the first one started
  std::string rendezvous;  ///< the same
};

int exit_code(pleat::ErrorCode code) {
  const bool input = code == pleat::ErrorCode::kInvalidArgument || code == pleat::ErrorCode::kNotFound ||
                     code == pleat::ErrorCode::kFailedPrecondition || code == pleat::ErrorCode::kDataLoss;
  return input ? 2 : 1;
}

int to_number(const std::string& option, const std::string& text, int low, int high) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < low || value > high) {
    pleat::throw_invalid_argument(option + " " + text + ": must be a number from " + std::to_string(low) + " to " +
                                  std::to_string(high));
  }
  return value;
}

Arguments parse(const std::vector<std::string>& words) {
  Arguments arguments;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::string& word = words[i];
    const auto next = [&]() -> const std::string& {
      if (i + 1 >= words.size()) pleat::throw_invalid_argument(word + " needs a value");
      return words[++i];
    };
    if (word == "--set") {
      arguments.changes.push_back(next());
    } else if (word == "--strict") {
      arguments.changes.emplace_back("strict=true");
    } else if (word == "--processes") {
      arguments.processes = to_number(word, next(), 1, 1024);
    } else if (word == "--rank") {
      arguments.rank = to_number(word, next(), 0, 1023);
    } else if (word == "--rendezvous") {
      arguments.rendezvous = next();
    } else if (word.rfind("--", 0) == 0 || !arguments.config.empty()) {
      pleat::throw_invalid_argument("unexpected argument " + word + "; see pleat-train --help");
    } else {
      arguments.config = word;
    }
  }
  if (arguments.config.empty()) pleat::throw_invalid_argument("no CONFIG; see pleat-train --help");
  return arguments;
}

/// The other processes of a data-parallel training: this program again, with a rank. They end with this one.
class Followers {
 public:
  Followers(const std::vector<std::string>& words, int processes, const std::string& rendezvous) {
    for (int rank = 1; rank < processes; ++rank) {
      std::vector<std::string> own{"pleat-train"};
      own.insert(own.end(), words.begin(), words.end());
      for (const std::string& word :
           {std::string("--rank"), std::to_string(rank), std::string("--rendezvous"), rendezvous}) {
        own.push_back(word);
      }
      std::vector<char*> pointers;
      for (std::string& word : own) pointers.push_back(word.data());
      pointers.push_back(nullptr);
      pid_t child = 0;
      if (::posix_spawn(&child, "/proc/self/exe", nullptr, nullptr, pointers.data(), environ) != 0) {
        throw pleat::Error(pleat::ErrorCode::kResourceExhausted, "can't start another process");
      }
      children_.push_back(child);
    }
  }
  /// They end by themselves when the training is done or this process is gone from the group; an error here must not
  /// leave them waiting.
  ~Followers() {
    if (!done_) {
      for (const pid_t child : children_) ::kill(child, SIGKILL);
    }
    for (const pid_t child : children_) ::waitpid(child, nullptr, 0);
  }
  Followers(const Followers&) = delete;
  Followers& operator=(const Followers&) = delete;
  void done() { done_ = true; }

 private:
  std::vector<pid_t> children_;
  bool done_ = false;
};

void run(const Arguments& arguments, const std::vector<std::string>& words) {
  using namespace pleat::superres;
  const TrainConfig config = read_train_config(arguments.config, arguments.changes);
  const bool first = arguments.rank == 0;
  const bool terminal = first && ::isatty(STDOUT_FILENO) == 1;
  TrainHooks hooks;
  hooks.git_revision = PLEAT_GIT_REVISION;
  hooks.stop = &stop_requested;
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
      const int filled = static_cast<int>(30 * fraction);
      std::printf("\r\033[Kepoch %d [%-30s] %3.0f %%  loss %.3e", epoch, std::string(filled, '#').c_str(),
                  100 * fraction, loss);
      std::fflush(stdout);
    };
  }
  // The first process converts the images; the others find them in files.
  const LoadedPairs pairs = load_pairs(config, hooks.line);
  std::unique_ptr<Followers> followers;
  if (first && arguments.processes > 1) {
    std::filesystem::create_directories(config.output);
    hooks.rendezvous = config.output + "/rendezvous." + std::to_string(::getpid());
    followers = std::make_unique<Followers>(words, arguments.processes, hooks.rendezvous);
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
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  for (const std::string& word : words) {
    if (word == "--help" || word == "-h") return std::fputs(kUsage, stdout) < 0 ? 1 : 0;
  }
  try {
    const Arguments arguments = parse(words);
    if (arguments.rank > 0) {
      // Ctrl-C reaches the whole group; the first process decides when all stop.
      std::signal(SIGINT, SIG_IGN);
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    } else {
      std::signal(SIGINT, [](int) { stop_requested = true; });
      std::signal(SIGTERM, [](int) { stop_requested = true; });
    }
    run(arguments, words);
    return 0;
  } catch (const pleat::Error& error) {
    std::fprintf(stderr, "pleat-train: %s: %s\n", std::string(to_string(error.code())).c_str(), error.what());
    return exit_code(error.code());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "pleat-train: %s\n", error.what());
    return 1;
  }
}
