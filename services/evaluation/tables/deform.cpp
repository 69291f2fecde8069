// The tables of [DT-S].
#include <algorithm>

#include "services/evaluation/bench_inputs.hpp"
#include "services/evaluation/tables/measure.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;

/// A set with a free fine simulation, and what [DT-S] prints of it. 0: nothing.
struct FreeSet {
  const char* key;      ///< of TablesOptions::free_sets; its bundle and configuration have the name, too
  const char* name;     ///< in tables
  const char* options;  ///< of pleat dataset generate
  PrintedTimes times;   ///< table 1; conversion: its extraction of features
  double rmse_mm;       ///< table 3, as if its unit were the metre
};
constexpr FreeSet kSets[] = {
    {"tshirt", "TSHIRT", "--set tshirt --scale full", {246, 14190, 8720, 867, 10, 730, 110, 12, 15}, 0},
    {"pants", "PANTS", "--set pants --scale full", {200, 11967, 10920, 904, 12, 800, 78, 13, 13}, 0},
    {"skirt-free",
     "SKIRT, free",
     "--set skirt --garment deploy/garments/skirt-127.obj --rounds 3 --fine free --train 18 --scale full",
     {127, 6812, 6840, 207, 33, 81, 100, 14, 12},
     0},
    {"sheet", "SHEET x16", "--set sheet --scale full", {0, 0, 0, 0, 0, 0, 0, 0, 0}, 5.89},
    {"sheet-64", "SHEET x64", "--set sheet --rounds 3 --scale full", {81, 4225, 2480, 157, 16, 35, 100, 11, 11}, 5.43},
    {"sheet-256", "SHEET x256", "--set sheet --rounds 4 --scale full", {0, 0, 0, 0, 0, 0, 0, 0, 0}, 5.31},
    {"disk", "DISK", "--set disk --scale full", {148, 7729, 4930, 139, 35, 78, 41, 12, 8}, 0}};
constexpr const char* kTracked = "sheet-tracked";  ///< SHEET x16 with a fine cloth that follows

/// What is changed in SHEET's ablations: the end of the configuration's name, and what to call it.
constexpr const char* kAblations[][2] = {{"-history", "tokens, own answers read too"},
                                         {"-no-obstacles", "tokens, no obstacles"},
                                         {"-no-spatial", "tokens, no spatial module"},
                                         {"-no-temporal", "tokens, no temporal module"},
                                         {"-1-frame", "tokens, 1 frame"},
                                         {"-5-frames", "tokens, 5 frames"},
                                         {"-width-16", "tokens, 16 features"},
                                         {"-width-64", "tokens, 64 features"},
                                         {"-group", "tokens, one deviation a group"},
                                         {"-features", "tokens, rotation and stretch"},
                                         {"-published-no-spatial", "published, no spatial module"},
                                         {"-published-no-temporal", "published, no temporal module"},
                                         {"-published-1-frame", "published, 1 frame"},
                                         {"-published-5-frames", "published, 5 frames"},
                                         {"-published-latent-8", "published, 8 numbers"},
                                         {"-published-latent-32", "published, 32 numbers"},
                                         {"-published-latent-64", "published, 64 numbers"},
                                         {"-published-layer-norm", "published, layer norm"},
                                         {"-published-deviation", "published, one deviation a group"},
                                         {"-published-offsets", "published, with offsets"},
                                         {"-published-gradients", "published, gradients"}};

std::vector<Wanted> wanted(const TablesOptions& options, const std::string& set) {
  std::vector<Wanted> list{{set, "tokens", training(options, set), true, true}};
  if (set != "sheet" && set != "disk") return list;
  list.push_back({set + "-published", "published", training(options, set + "-published")});
  if (set == "disk") return list;
  list.push_back({"sheet-mfsr", "MFSR, not tracked", training(options, "sheet-mfsr")});
  list.push_back({"sheet-mfsr-tracked", "MFSR, tracked", training(options, "sheet-mfsr-tracked")});
  for (const auto& [end, label] : kAblations) list.push_back({set + end, label, training(options, set + end)});
  return list;
}

fs::path folder_of(const TablesOptions& options, const std::string& key) {
  const auto found = options.free_sets.find(key);
  return found != options.free_sets.end() && !found->second.empty() ? found->second : fs::path("out/dataset") / key;
}

Benchmark measure_set(const TablesOptions& options, const FreeSet& set, const TablesProgress& progress) {
  const fs::path folder = folder_of(options, set.key);
  Request request{set.name,
                  folder,
                  "build/bin/pleat dataset generate " + folder.string() + " " + set.options,
                  wanted(options, set.key),
                  {}};
  if (request.bundles.front().name == "sheet") request.tracked = folder_of(options, kTracked);
  Benchmark benchmark = measure(options, std::move(request), progress);
  if (benchmark.missing.empty() && options.timed_frames > 0) {
    const DatasetReader dataset(folder);
    const std::string scene = chosen_sequences(dataset, {}).front().scene;
    benchmark.coarse_ms = frame_time(scene, simulation::Mode::kCoarse, options.timed_frames).median;
    benchmark.fine_ms = frame_time(scene, simulation::Mode::kFreeFine, options.timed_frames).median;
  }
  return benchmark;
}

Table table1(const std::vector<Benchmark>& benchmarks) {
  Table table{"deform1",
              "[DT-S] table 1. Sizes and milliseconds a frame",
              {"set"},
              {"vertices coarse", "vertices fine", "fine simulation ms", "ours ms", "speed-up", "coarse ms",
               "conversion ms", "network ms", "refinement ms"},
              {"%.0f", "%.0f", "%.1f", "%.1f", "%.1f", "%.1f", "%.2f", "%.2f", "%.2f"},
              {},
              "Printed: ARCSim, extraction of features, a network on a GPU. Measured: medians on this machine, both "
              "simulations over the first frames of a test sequence, all other stages over all of them."};
  for (std::size_t i = 0; i < benchmarks.size(); ++i) {
    const Wanted& bundle = benchmarks[i].request.bundles.front();
    table.rows.push_back(row_of_times(benchmarks[i], kSets[i].times, &bundle, bundle.command));
  }
  return table;
}

TableEntry rmse(const Benchmark& b, const std::string& method, const std::string& command) {
  TableEntry entry{{}, {}, b.missing.empty() ? command : b.missing};
  const auto found = b.figures.find(method);
  if (found != b.figures.end()) entry = {{}, 1e3 * found->second.metrics.rmse_m, {}};
  return entry;
}

Table table3(const std::vector<Benchmark>& benchmarks) {
  Table table{"deform3",
              "[DT-S] table 3. RMSE by coarse mesh, of one fine mesh with 8,192 faces",
              {"set"},
              {"upsampling mm", "tokens mm"},
              {2, "%.2f"},
              {},
              "Printed without a unit, beside the tokens as if it were the metre."};
  for (std::size_t i = 0; i < benchmarks.size(); ++i) {
    if (kSets[i].rmse_mm == 0) continue;
    const Wanted& bundle = benchmarks[i].request.bundles.front();
    TableRow row{{kSets[i].name},
                 {rmse(benchmarks[i], "barycentric", ""), rmse(benchmarks[i], bundle.name, bundle.command)}};
    row.entries[1].printed = kSets[i].rmse_mm;
    table.rows.push_back(std::move(row));
  }
  return table;
}

/// What it measures of a free fine simulation, and in place of its user study what eyes see at once.
Table table_of_methods(const std::vector<Benchmark>& benchmarks) {
  Table table{
      "deform2",
      "[DT-S]. A free fine simulation, sequences that were not trained on",
      {"set", "method"},
      {"RMSE mm", "Hausdorff mm", "STED", "normals deg", "jitter", "wrinkles 0-1", "wrinkles 1-4", "wrinkles 4-16"},
      {"%.2f", "%.1f", "%.4f", "%.2f", "%.2f", "%.2f", "%.2f", "%.2f"},
      {},
      "'tokens' is the shipped bundle, through the whole pipeline; the others are measured before refinement. "
      "Jitter and wrinkles (by bands of fine edges) are over the reference's, 1 is right: in place of the "
      "paper's user study, its table 2. 'Tracked' methods learnt from a fine cloth that follows the coarse "
      "one."};
  for (const Benchmark& b : benchmarks) {
    const auto add = [&](const std::string& label, const std::string& method, const std::string& command) {
      TableRow row{{b.request.name, label}, {8, TableEntry{{}, {}, b.missing.empty() ? command : b.missing}}};
      if (const auto found = b.figures.find(method); found != b.figures.end()) {
        const MetricValues& m = found->second.metrics;
        const double values[] = {1e3 * m.rmse_m, 1e3 * m.hausdorff_m, m.sted.combined, m.normal_angle_deg,
                                 m.jitter_ratio, m.wrinkles[0],       m.wrinkles[1],   m.wrinkles[2]};
        for (std::size_t i = 0; i < row.entries.size(); ++i) row.entries[i] = {{}, values[i], {}};
      }
      table.rows.push_back(std::move(row));
    };
    add("barycentric upsampling", "barycentric", "");
    add("Zurdo 2013, not tracked", "zurdo2013", "a data set with sequences of the split 'train'");
    if (!b.request.tracked.empty()) {
      add("Zurdo 2013, tracked", "zurdo2013-tracked",
          "build/bin/pleat dataset generate " + b.request.tracked.string() +
              " --set sheet --fine tracked --scale full");
    }
    for (const Wanted& bundle : b.request.bundles) add(bundle.label, bundle.name, bundle.command);
  }
  return table;
}

}  // namespace

std::vector<std::pair<std::string, std::string>> free_set_names() {
  std::vector<std::pair<std::string, std::string>> names;
  for (const FreeSet& set : kSets) names.emplace_back(set.key, set.name);
  names.emplace_back(kTracked, "SHEET x16, tracked");
  return names;
}

void add_deform_tables(const TablesOptions& options, const TablesProgress& progress, PaperTables& result) {
  std::vector<Benchmark> benchmarks;
  for (const FreeSet& set : kSets) benchmarks.push_back(measure_set(options, set, progress));
  for (Table& table : std::vector<Table>{table1(benchmarks), table_of_methods(benchmarks), table3(benchmarks)})
    result.tables.push_back(std::move(table));
  for (const Benchmark& b : benchmarks) {
    if (!b.missing.empty()) continue;
    const std::vector<Wanted>& bundles = b.request.bundles;
    Panels panels{{"coarse", "coarse", ""}};
    if (bundles.size() > 3) {
      panels.push_back({bundles[3].label, bundles[3].name, bundles[3].command});
      panels.push_back({bundles[2].label, bundles[2].name, bundles[2].command});
      panels.push_back({"Zurdo 2013, tracked", "zurdo2013-tracked", "a tracked data set"});
    }
    panels.push_back({"Zurdo 2013, not tracked", "zurdo2013", "a data set with sequences of the split 'train'"});
    panels.push_back({"tokens", bundles[0].name, bundles[0].command});
    panels.push_back({"simulated", "reference", ""});
    result.deform.push_back(pictures(b, panels));
  }
}

}  // namespace pleat::evaluation
