// `pleat bench`: figures of this machine.
#include <algorithm>
#include <cstdio>
#include <optional>

#include "common/base/machine.hpp"
#include "common/base/own_file.hpp"
#include "common/base/process.hpp"
#include "common/base/progress.hpp"
#include "common/base/whole_file.hpp"
#include "services/cli/command.hpp"
#include "services/evaluation/bench.hpp"
#include "services/evaluation/tables/tables.hpp"

namespace pleat::cli {
namespace {

struct Benchmark {
  const char* name;
  evaluation::Figures (*run)(const evaluation::BenchOptions&);
};
constexpr Benchmark kBenchmarks[] = {{"simulation", evaluation::bench_simulation},
                                     {"conversion", evaluation::bench_conversion},
                                     {"superres", evaluation::bench_superres},
                                     {"refinement", evaluation::bench_refinement},
                                     {"pipeline", evaluation::bench_pipeline}};

constexpr const char* kTables = "tables";
// The second: of pages from before there was a first.
constexpr std::string_view kTablesMarks[] = {"<meta name=\"generator\" content=\"pleat.tables\">",
                                             "<title>Pleat: the paper's tables</title>"};

struct BenchChoice {
  std::vector<std::string> names;  // empty: all
  evaluation::BenchOptions options;
  evaluation::TablesOptions tables;
  bool json = false;
};

void print_figures(const std::string& name, const evaluation::Figures& figures) {
  std::printf("%s\n", name.c_str());
  for (const auto& [figure, value] : figures)
    std::printf("  %-36s %12.5g %-28s (%zu runs)\n", figure.c_str(), value.median, value.unit.c_str(), value.runs);
  std::fflush(stdout);
}

/// FOLDER-full, which the paper's sizes make, before FOLDER.
std::filesystem::path larger(const std::filesystem::path& folder) {
  const std::filesystem::path full = folder.string() + "-full";
  return std::filesystem::exists(full / "dataset.h5") ? full : folder;
}

/// Needs data sets and trained bundles, and minutes: not among the benchmarks that run without a name.
int tables(BenchChoice choice) {
  evaluation::TablesOptions& options = choice.tables;
  options.models = choice.options.models;
  options.out = choice.options.out;
  if (options.draping.empty()) options.draping = larger("out/dataset/draping");
  if (options.hitting.empty()) options.hitting = larger("out/dataset/hitting");
  if (options.skirt.empty()) options.skirt = larger("out/dataset/skirt");
  make_writable_folder(options.out);
  const std::filesystem::path page = options.out / "tables.html";
  require_replaceable(page, kTablesMarks);
  std::optional<Progress> progress;
  std::string shown;
  const evaluation::PaperTables result =
      evaluation::make_tables(options, [&](std::uint64_t done, std::uint64_t total, const std::string& benchmark) {
        if (!progress || shown != benchmark) progress.emplace(benchmark + ", frames", total);
        shown = benchmark;
        progress->update(done);
      });
  if (progress) progress->finish();
  write_whole_file(page, evaluation::to_html(result));
  if (choice.json) {
    const nlohmann::json json{
        {"tables", to_json(result)}, {"machine", machine_info()}, {"git_revision", git_revision()}};
    std::printf("%s\n", json.dump(2).c_str());
  } else {
    std::printf("%sError maps and curves: %s\n", to_text(result).c_str(), page.string().c_str());
  }
  return kExitDone;
}

int bench(const BenchChoice& choice) {
  if (std::find(choice.names.begin(), choice.names.end(), kTables) != choice.names.end()) {
    if (choice.names.size() > 1) throw_invalid_argument("bench tables: goes without other names");
    return tables(choice);
  }
  nlohmann::json json = nlohmann::json::object();
  const nlohmann::json machine = machine_info();
  for (const Benchmark& benchmark : kBenchmarks) {
    if (!choice.names.empty() && std::count(choice.names.begin(), choice.names.end(), benchmark.name) == 0) continue;
    const evaluation::Figures figures = benchmark.run(choice.options);
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
  names.emplace_back(kTables);
  app->add_option(
         "names", choice->names,
         "one or several of them (default: all but tables, the paper's with our figures beside the printed ones)")
      ->check(CLI::IsMember(names));
  add_json_option(*app, choice->json, "print one JSON object: name -> figure -> {median, runs, unit}");
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
  choice->options.out.clear();
  app->add_option(
      "--out", choice->options.out,
      "folder for logs and files of jobs (default: out/bench in a build, else $XDG_STATE_HOME/pleat/bench)");
  const auto tables = app->add_option_group("tables", "for 'tables'");
  tables->add_option("--draping", choice->tables.draping,
                     "data set (default: out/dataset/draping-full, else out/dataset/draping)");
  tables->add_option("--hitting", choice->tables.hitting, "the same for HITTING");
  tables->add_option("--skirt", choice->tables.skirt, "the same for SKIRT");
  for (const auto& [name, title] : evaluation::free_set_names()) {
    tables->add_option("--" + name, choice->tables.free_sets[name], "data set " + title)
        ->default_str("out/dataset/" + name);
  }
  tables->add_option("--trained", choice->tables.trained, "folder of trainings")->capture_default_str();
  tables->add_option("--every", choice->tables.every, "of each test sequence every N-th frame is measured")
      ->capture_default_str()
      ->check(positive_number());
  tables->add_option("--first", choice->tables.frames, "the first so many frames of each test sequence only")
      ->check(positive_number());
  tables->add_option("--timed", choice->tables.timed_frames, "frames that are simulated for Table 1; 0: none")
      ->capture_default_str();
  return {{app, [choice] {
             if (choice->options.out.empty()) choice->options.out = state_folder("bench");
             return bench(*choice);
           }}};
}

}  // namespace pleat::cli
