#include "services/superres/training/program.hpp"

#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>

#include "common/base/error.hpp"
#include "services/superres/bundle/any_mesh.hpp"
#include "services/superres/bundle/re_export.hpp"
#include "services/superres/training/followers.hpp"
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

}  // namespace

void run_training(const TrainArguments& arguments) {
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
  if (!arguments.any_mesh.empty()) return serve_any_mesh(arguments.any_mesh, arguments.garment, arguments.out);
  if (!arguments.garment.empty()) return add_rest_mesh(arguments.re_export, arguments.garment, arguments.out);
  if (rewrites) return re_export(arguments.re_export, arguments.out);
  if (arguments.config.empty()) throw_invalid_argument("no configuration; see pleat-train --help");
  const TrainConfig config = read_train_config(arguments.config, arguments.changes);
  TrainHooks hooks = hooks_of(arguments);
  // The first process converts the images; the others find them in files.
  const LoadedPairs pairs =
      load_pairs(config, hooks.line, [&] { return arguments.stop != nullptr && arguments.stop->load(); });
  std::optional<Followers> followers;
  if (arguments.rank == 0 && arguments.processes > 1) {
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
}

}  // namespace pleat::superres
