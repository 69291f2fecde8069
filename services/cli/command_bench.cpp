// `pleat bench`: figures of this machine.
#include <algorithm>
#include <cstdio>

#include "services/cli/bench.hpp"
#include "services/cli/command.hpp"
#include "services/cli/machine.hpp"

namespace pleat::cli {
namespace {

struct Benchmark {
  const char* name;
  Figures (*run)(const BenchOptions&);
};
constexpr Benchmark kBenchmarks[] = {{"simulation", bench_simulation},
                                     {"conversion", bench_conversion},
                                     {"superres", bench_superres},
                                     {"refinement", bench_refinement},
                                     {"pipeline", bench_pipeline}};

struct BenchChoice {
  std::vector<std::string> names;  // empty: all
  BenchOptions options;
  bool json = false;
};

void print_figures(const std::string& name, const Figures& figures) {
  std::printf("%s\n", name.c_str());
  for (const auto& [figure, value] : figures)
    std::printf("  %-36s %12.5g %-28s (%zu runs)\n", figure.c_str(), value.median, value.unit.c_str(), value.runs);
  std::fflush(stdout);
}

int bench(const BenchChoice& choice) {
  nlohmann::json json = nlohmann::json::object();
  const nlohmann::json machine = machine_info();
  for (const Benchmark& benchmark : kBenchmarks) {
    if (!choice.names.empty() && std::count(choice.names.begin(), choice.names.end(), benchmark.name) == 0) continue;
    const Figures figures = benchmark.run(choice.options);
    json.update(to_json(benchmark.name, figures));
    if (!choice.json) print_figures(benchmark.name, figures);
  }
  json["machine"] = machine;
  json["git_revision"] = git_revision();
  if (choice.json)
    std::printf("%s\n", json.dump(2).c_str());
  else
    std::printf("%s, %zu processors, revision %s\n", machine.value("processor", "").c_str(),
                machine.value("processors", std::size_t{0}), git_revision().c_str());
  return kExitDone;
}

}  // namespace

std::vector<Command> add_bench(CLI::App& root) {
  CLI::App* app = root.add_subcommand("bench", "benchmarks; medians on this machine");
  const auto choice = std::make_shared<BenchChoice>();
  std::vector<std::string> names;
  for (const Benchmark& benchmark : kBenchmarks) names.emplace_back(benchmark.name);
  app->add_option("names", choice->names, "one or several of them (default: all)")->check(CLI::IsMember(names));
  app->add_flag("--json", choice->json, "one JSON object: name -> figure -> {median, runs, unit}");
  app->add_option("--frames", choice->options.frames, "frames (or runs) of a figure; costly ones take a quarter")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--scene", choice->options.scene,
                  "scene file (default: deploy/scenes/draping.json; refinement: hitting.json)");
  app->add_option("--models", choice->options.models, "folder of the model bundles (default: deploy/models)");
  app->add_option("--model", choice->options.model,
                  "refinement: bundle in that folder that enhances the data set's frames (default: the service's)");
  app->add_option(
      "--dataset", choice->options.dataset,
      "conversion, refinement: folder of a data set, for its test frames (default: frames made on the spot)");
  app->add_option("--out", choice->options.out, "folder for logs and files of jobs")->capture_default_str();
  return {{app, [choice] { return bench(*choice); }}};
}

}  // namespace pleat::cli
