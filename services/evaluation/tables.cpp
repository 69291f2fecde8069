#include "services/evaluation/tables.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>

#include "common/base/scratch_folder.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/rpc/channel.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/evaluation/bench.hpp"
#include "services/evaluation/evaluation.hpp"
#include "services/evaluation/metrics.hpp"
#include "services/evaluation/session_method.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kGap = 2;  ///< spaces between columns of text

const char* const kLosses[] = {"d", "dn", "dv", "dnv", "all"};
const char* const kLossNames[] = {"L_d", "L_d+n", "L_d+v", "L_d+n+v", "L_all"};

/// What [MFSR] prints of one benchmark.
struct Printed {
  const char* name;
  double coarse_vertices, fine_vertices;
  double tracked_ms, ours_ms, speedup, coarse_ms, conversion_ms, network_ms, refinement_ms;  // Table 1, in ms
  double chen_psnr, chen_vmse, zurdo_vmse, own_psnr, own_vmse;                               // Table 2
  double losses[5];                                                                          // Table 3
};
constexpr Printed kPrinted[] = {
    {"DRAPING",
     749,
     11393,
     4270,
     345,
     12,
     129,
     89,
     55.3,
     71.8,
     59.07,
     4.19e-4,
     1.30e-4,
     68.91,
     7.09e-5,
     {67.90, 62.83, 67.92, 63.47, 68.68}},
    {"HITTING",
     749,
     11393,
     4380,
     341,
     13,
     135,
     109,
     53.1,
     43.4,
     59.15,
     1.17e-4,
     5.78e-5,
     72.25,
     4.69e-5,
     {67.11, 68.23, 71.41, 69.75, 71.26}},
    {"SKIRT", 1303, 19798, 10230, 709, 14, 227, 180, 28.1, 274, 0, 0, 0, 0, 0, {62.48, 60.76, 62.48, 61.31, 62.88}}};

/// [DT-S]'s sets that are made here, with 16 fine faces of one. It prints one figure for SHEET, without a unit.
constexpr Printed kFeatureSets[] = {{"SHEET", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, {}},
                                    {"DISK", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, {}}};
constexpr double kPrintedSheet = 0.00589;

/// What is changed in one of its ablations: the end of the configuration's name, and what to call it.
constexpr const char* kAblations[][2] = {{"-history", "tokens, own answers read too"},
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

/// A bundle that a table asks for.
struct Wanted {
  std::string name;  ///< of the bundle; also of its folder and configuration
  std::string label;
  std::string command;  ///< that makes it
  bool shipped = false;
};

/// One benchmark on this machine.
struct Benchmark {
  const Printed* printed = nullptr;
  fs::path dataset;
  std::string missing;                           ///< the command that makes the data set, if it is not there
  std::map<std::string, MethodFigures> figures;  ///< by method: "barycentric", "zurdo2013", or a bundle
  std::optional<double> coarse_ms, tracked_ms;
  PictureRow frame;  ///< the frame of the figures; pictures by label in `positions`
  std::map<std::string, Positions> positions;
};

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

bool is_feature_set(const std::string& set) {
  return std::any_of(std::begin(kFeatureSets), std::end(kFeatureSets),
                     [&](const Printed& printed) { return lower(printed.name) == set; });
}

std::vector<Wanted> wanted(const TablesOptions& options, const std::string& set) {
  const auto training = [&](const std::string& name) {
    return "build/bin/pleat-train " + (options.configurations / (name + ".train.json")).string();
  };
  if (is_feature_set(set)) {
    std::vector<Wanted> list{{set, "tokens", training(set), true},
                             {set + "-published", "published", training(set + "-published")}};
    for (const auto& [end, label] : kAblations) {
      if (set == "sheet") list.push_back({set + end, label, training(set + end)});
    }
    return list;
  }
  std::vector<Wanted> list{{set, "MFSR as shipped", training(set), true},
                           {set + "-compare", "MFSR", training(set + "-compare")},
                           {set + "-chen2018", "Chen 2018", training(set + "-chen2018")},
                           {set + "-srresnet", "SRResNet body", training(set + "-srresnet")}};
  for (std::size_t i = 0; i < std::size(kLosses); ++i) {
    const std::string name = set + "-loss-" + kLosses[i];
    list.push_back({name, kLossNames[i], training(name)});
  }
  return list;
}

/// The frame that has most of what upsampling lacks.
void choose_frame(const DatasetReader& dataset, const TablesOptions& options, std::string& sequence,
                  std::uint64_t& index) {
  const Subdivision subdivision = subdivide(dataset.topology().coarse, subdivision_of(dataset.topology()));
  double most = -1;
  for (const SequenceInfo& info : chosen_sequences(dataset, {})) {
    const std::uint64_t frames =
        options.frames > 0 ? std::min<std::uint64_t>(options.frames, info.frames_complete) : info.frames_complete;
    for (std::uint64_t k = 0; k < frames; k += options.every) {
      const Positions coarse = std::move(dataset.coarse(info.name, k, k + 1).at(0));
      const double error = vertex_mean_square_error(std::move(dataset.fine(info.name, k, k + 1).at(0)),
                                                    upsample(subdivision, dataset.topology().coarse.faces, coarse));
      if (error > most) most = error, sequence = info.name, index = k;
    }
  }
}

/// The same method, whose mesh of one frame is kept.
Method watched(const Method& method, const std::string& sequence, std::uint64_t index, Positions& kept) {
  return {method.name, [=, &kept](const MethodInput& input, const auto& sink) {
            method.run(input, [&](std::uint64_t k, const MethodFrame& frame) {
              if (input.sequence == sequence && k == index) kept = frame.positions;
              sink(k, frame);
            });
          }};
}

/// Bundles of one benchmark into a folder of their own, from which the services load them.
std::vector<std::string> collect(const TablesOptions& options, const std::string& set, const fs::path& folder) {
  std::vector<std::string> names;
  for (const Wanted& bundle : wanted(options, set)) {
    const fs::path models = options.models.empty() ? cli::default_models_folder() : options.models;
    fs::path file = options.trained / bundle.name / (bundle.name + ".pt");
    if (const fs::path own = models / (bundle.name + ".pt"); bundle.shipped && fs::exists(own)) file = own;
    if (!fs::exists(file)) continue;
    fs::copy_file(file, folder / (bundle.name + ".pt"));
    names.push_back(bundle.name);
  }
  return names;
}

Benchmark measure(const TablesOptions& options, const Printed& printed, const fs::path& data,
                  const std::function<void(std::uint64_t, std::uint64_t, const std::string&)>& progress) {
  Benchmark benchmark;
  benchmark.printed = &printed;
  benchmark.dataset = data;
  const std::string set = lower(printed.name);
  if (!fs::exists(data / "dataset.h5")) {
    benchmark.missing = set == "skirt" ? "no data: a body's motion to simulate it with is not part of Pleat"
                                       : "build/bin/pleat dataset generate " + data.string() + " --set " + set;
    if (is_feature_set(set)) benchmark.missing += " --scale full";
    return benchmark;
  }
  if (options.timed_frames > 0 && !is_feature_set(set)) {
    BenchOptions timing;
    timing.frames = options.timed_frames;
    timing.scene = fs::path("deploy/scenes") / (set + ".json");
    benchmark.coarse_ms = coarse_frame_time(timing).median;
    benchmark.tracked_ms = tracked_frame_time(timing).median;
  }
  const DatasetReader dataset(data);
  std::string sequence;
  std::uint64_t index = 0;
  choose_frame(dataset, options, sequence, index);
  benchmark.frame.title = std::string(printed.name) + ", " + sequence + ", frame " + std::to_string(index);
  benchmark.frame.coarse_faces = dataset.topology().coarse.faces;
  benchmark.frame.fine_faces = dataset.topology().fine.faces;
  benchmark.positions["coarse"] = std::move(dataset.coarse(sequence, index, index + 1).at(0));
  benchmark.positions["reference"] = std::move(dataset.fine(sequence, index, index + 1).at(0));

  fs::create_directories(options.out);
  const ScratchFolder models(options.out, ".pleat-models");
  const std::vector<std::string> bundles = collect(options, set, models.path());
  std::vector<Method> methods{barycentric_method(dataset.topology())};
  const auto all = dataset.sequences();
  if (std::any_of(all.begin(), all.end(), [](const SequenceInfo& s) { return s.split == "train"; }))
    methods.push_back(zurdo_method(dataset));
  std::optional<cli::Launcher> launcher;
  if (!bundles.empty()) {
    cli::LauncherOptions launch;
    launch.models = models.path();
    launch.model = bundles.front();
    launch.data = options.out / "services";
    launch.logs = options.out / "logs";
    launcher.emplace(launch);
    const auto client = std::make_shared<client::Client>(launcher->coordinator());
    for (const std::string& name : bundles) {
      Method method = session_method(client, dataset.topology(), {.model = name, .refine = name == set});
      method.name = name;
      methods.push_back(method);
    }
  }
  for (Method& method : methods) method = watched(method, sequence, index, benchmark.positions[method.name]);
  EvaluationOptions evaluation;
  evaluation.frames = options.frames;
  evaluation.every = options.every;
  for (MethodFigures& figures : evaluate(dataset, methods, evaluation, [&](std::uint64_t done, std::uint64_t total) {
         progress(done, total, printed.name);
       })) {
    const std::string name = figures.name;
    benchmark.figures.emplace(name, std::move(figures));
  }
  return benchmark;
}

std::string joined(const std::vector<std::string>& names) {
  std::string text = names.front();
  for (std::size_t i = 1; i < names.size(); ++i) text += ", " + names[i];
  return text;
}

std::optional<double> stage(const Benchmark& benchmark, const std::string& bundle,
                            const std::vector<std::string>& stages) {
  const auto found = benchmark.figures.find(bundle);
  if (found == benchmark.figures.end()) return {};
  double sum = 0;
  bool any = false;
  for (const auto& [name, ms] : found->second.median_ms) {
    if (std::find(stages.begin(), stages.end(), name) != stages.end()) sum += ms, any = true;
  }
  return any ? std::optional<double>(sum) : std::nullopt;
}

/// The bundle whose times stand for "ours".
const Wanted* fastest_known(const Benchmark& benchmark, const std::vector<Wanted>& bundles) {
  for (const Wanted& bundle : bundles) {
    if (benchmark.figures.count(bundle.name) > 0) return &bundle;
  }
  return nullptr;
}

Table table1(const TablesOptions& options, const std::vector<Benchmark>& benchmarks) {
  Table table{"table1",
              "Table 1. Sizes and milliseconds a frame",
              {"benchmark"},
              {"vertices coarse", "vertices fine", "tracked ms", "ours ms", "speed-up", "coarse ms", "conversion ms",
               "network ms", "refinement ms"},
              {"%.0f", "%.0f", "%.1f", "%.1f", "%.1f", "%.1f", "%.2f", "%.1f", "%.2f"},
              {},
              "Printed: ARCSim and conversion on a 2.5 GHz four-core processor, the network on a GTX 1080 Ti, 2021. "
              "Measured: medians on this machine, simulation of the shipped scene, all other stages on the test "
              "sequences; a frame is 40 ms of motion in 8 steps."};
  for (const Benchmark& b : benchmarks) {
    const Printed& p = *b.printed;
    const auto bundles = wanted(options, lower(p.name));
    const Wanted* bundle = fastest_known(b, bundles);
    const std::string name = bundle != nullptr ? bundle->name : "";
    const std::string why = !b.missing.empty() ? b.missing : bundles.front().command;
    const auto coarse = b.coarse_ms, conversion = stage(b, name, {"to_image", "to_mesh"}),
               network = stage(b, name, {"superres"}), refinement = stage(b, name, {"refinement"});
    std::optional<double> ours, speedup;
    if (coarse && conversion && network && refinement) ours = *coarse + *conversion + *network + *refinement;
    if (ours && b.tracked_ms) speedup = *b.tracked_ms / *ours;
    std::optional<double> coarse_vertices, fine_vertices;
    if (b.missing.empty()) {
      coarse_vertices = static_cast<double>(b.positions.at("coarse").rows());
      fine_vertices = static_cast<double>(b.positions.at("reference").rows());
    }
    const std::string no_times = b.missing.empty() ? "build/bin/pleat bench tables" : b.missing;
    table.rows.push_back({{p.name},
                          {{p.coarse_vertices, coarse_vertices, b.missing},
                           {p.fine_vertices, fine_vertices, b.missing},
                           {p.tracked_ms, b.tracked_ms, no_times},
                           {p.ours_ms, ours, why},
                           {p.speedup, speedup, why},
                           {p.coarse_ms, coarse, no_times},
                           {p.conversion_ms, conversion, why},
                           {p.network_ms, network, why},
                           {p.refinement_ms, refinement, why}}});
  }
  return table;
}

void add_row(Table& table, const Benchmark& b, const std::string& label, const std::string& method,
             const std::string& command, std::optional<double> psnr, std::optional<double> vmse) {
  const auto found = b.figures.find(method);
  TableRow row{{b.printed->name, label}, {{psnr, {}, {}}, {vmse, {}, {}}, {{}, {}, {}}}};
  for (TableEntry& entry : row.entries) entry.missing = b.missing.empty() ? command : b.missing;
  if (found != b.figures.end()) {
    row.entries[0].measured = found->second.metrics.psnr_db;
    row.entries[1].measured = found->second.metrics.vmse_m2;
    row.entries[2].measured = 1e3 * found->second.metrics.rmse_m;
    for (TableEntry& entry : row.entries) entry.missing.clear();
  }
  table.rows.push_back(std::move(row));
}

Table table2(const TablesOptions& options, const std::vector<Benchmark>& benchmarks) {
  Table table{"table2",
              "Table 2. Methods on sequences that were not trained on",
              {"benchmark", "method"},
              {"PSNR dB", "VMSE m2", "RMSE mm"},
              {"%.2f", "%.2e", "%.3f"},
              {},
              "The paper trains one network on both sets; here each set has its own. 'Chen 2018', 'SRResNet body' and "
              "'MFSR' were trained for the same processor time; 'MFSR as shipped' longer (its model card says how "
              "long). The shipped one runs through "
              "the whole pipeline; the others are measured before refinement, which would hide their errors (a mesh "
              "that intersects itself goes back to the upsampled coarse one). The paper calls its VMSE an error in "
              "metres; here it is the mean of squared distances."};
  for (const Benchmark& b : benchmarks) {
    const Printed& p = *b.printed;
    if (p.own_psnr == 0) continue;
    const std::string set = lower(p.name);
    const auto bundles = wanted(options, set);
    add_row(table, b, "barycentric upsampling", "barycentric", "", {}, {});
    add_row(table, b, "Zurdo 2013", "zurdo2013", "a data set with sequences of the split 'train'", {}, p.zurdo_vmse);
    add_row(table, b, bundles[2].label, bundles[2].name, bundles[2].command, p.chen_psnr, p.chen_vmse);
    add_row(table, b, bundles[3].label, bundles[3].name, bundles[3].command, {}, {});
    add_row(table, b, bundles[1].label, bundles[1].name, bundles[1].command, p.own_psnr, p.own_vmse);
    add_row(table, b, bundles[0].label, bundles[0].name, bundles[0].command, p.own_psnr, p.own_vmse);
  }
  return table;
}

Table table3(const TablesOptions& options, const std::vector<Benchmark>& benchmarks) {
  Table table{
      "table3",
      "Table 3. Displacement PSNR, dB, by the terms of the loss",
      {"benchmark"},
      {std::begin(kLossNames), std::end(kLossNames)},
      {5, "%.2f"},
      {},
      "L_all has the kinematic loss over windows of four frames, so that a step shows a quarter of the scenes."};
  for (const Benchmark& b : benchmarks) {
    const auto bundles = wanted(options, lower(b.printed->name));
    TableRow row{{b.printed->name}, {}};
    for (std::size_t i = 0; i < std::size(kLosses); ++i) {
      const Wanted& bundle = bundles[bundles.size() - std::size(kLosses) + i];
      TableEntry entry{b.printed->losses[i], {}, b.missing.empty() ? bundle.command : b.missing};
      if (const auto found = b.figures.find(bundle.name); found != b.figures.end()) {
        entry.measured = found->second.metrics.psnr_db;
        entry.missing.clear();
      }
      row.entries.push_back(std::move(entry));
    }
    table.rows.push_back(std::move(row));
  }
  return table;
}

/// [DT-S]: what it measures of a free fine simulation, and in place of its user study what eyes see at once.
Table table_of_features(const TablesOptions& options, const std::vector<Benchmark>& benchmarks) {
  Table table{"features",
              "[DT-S]. A free fine simulation, sequences that were not trained on",
              {"set", "method"},
              {"RMSE mm", "Hausdorff mm", "STED", "normals deg", "jitter", "wrinkles 1-4", "wrinkles 4-16"},
              {"%.2f", "%.1f", "%.4f", "%.2f", "%.2f", "%.2f", "%.2f"},
              {},
              "Printed: 0.00589 for its own SHEET, without a unit; here as if it were metres. 'tokens' is the shipped "
              "bundle, through the whole pipeline; the others are measured before refinement. Jitter and wrinkles "
              "(by bands of fine edges): over the reference's, 1 is right."};
  const auto add = [&](const Benchmark& b, const std::string& label, const std::string& method,
                       const std::string& command, std::optional<double> printed) {
    TableRow row{{b.printed->name, label}, {7, TableEntry{{}, {}, b.missing.empty() ? command : b.missing}}};
    row.entries[0].printed = printed;
    if (const auto found = b.figures.find(method); found != b.figures.end()) {
      const MetricValues& m = found->second.metrics;
      const double values[] = {1e3 * m.rmse_m, 1e3 * m.hausdorff_m, m.sted.combined, m.normal_angle_deg,
                               m.jitter_ratio, m.wrinkles[1],       m.wrinkles[2]};
      for (std::size_t i = 0; i < row.entries.size(); ++i) row.entries[i] = {row.entries[i].printed, values[i], {}};
    }
    table.rows.push_back(std::move(row));
  };
  for (const Benchmark& b : benchmarks) {
    const std::string set = lower(b.printed->name);
    add(b, "barycentric upsampling", "barycentric", "", {});
    add(b, "Zurdo 2013", "zurdo2013", "a data set with sequences of the split 'train'", {});
    for (const Wanted& bundle : wanted(options, set)) {
      const bool published = bundle.name == "sheet-published";
      add(b, bundle.label, bundle.name, bundle.command, published ? std::optional(1e3 * kPrintedSheet) : std::nullopt);
    }
  }
  return table;
}

Table table_of_figure13(const TablesOptions& options, std::vector<Convergence>& curves) {
  Table table{"figure13",
              "Fig. 13. PSNR, dB, of the three features at the end of training (validation sequence of DRAPING)",
              {"body"},
              {"displacement", "normal", "velocity", "minutes"},
              {"%.2f", "%.2f", "%.2f", "%.1f"},
              {},
              "The paper prints curves without figures; in them the dense body is above SRResNet in all three "
              "features. Minutes are those of the training's own clock."};
  const auto bundles = wanted(options, "draping");
  for (const std::size_t i : {std::size_t{1}, std::size_t{3}}) {
    const Wanted& bundle = bundles[i];
    Convergence curve =
        read_convergence(i == 1 ? "residual dense blocks" : "SRResNet", options.trained / bundle.name / "log.csv");
    TableRow row{{curve.name}, {4, TableEntry{{}, {}, bundle.command}}};
    if (!curve.minutes.empty()) {
      const double last[] = {curve.displacement_db.back(), curve.normal_db.back(), curve.velocity_db.back(),
                             curve.minutes.back()};
      for (std::size_t k = 0; k < 4; ++k) row.entries[k] = {{}, last[k], {}};
    }
    table.rows.push_back(std::move(row));
    if (!curve.minutes.empty()) curves.push_back(std::move(curve));
  }
  return table;
}

/// (label, name of the positions, command)
using Panels = std::vector<std::array<std::string, 3>>;

PictureRow pictures(const Benchmark& b, const Panels& panels) {
  PictureRow row = b.frame;
  for (const auto& [label, name, command] : panels) {
    Picture picture{label, {}, name == "coarse", name == "reference", {}};
    if (const auto found = b.positions.find(name); found != b.positions.end()) picture.positions = found->second;
    if (picture.positions.rows() == 0) picture.missing = command;
    row.pictures.push_back(std::move(picture));
  }
  return row;
}

}  // namespace

bool has_printed(const Table& table, std::size_t column) {
  return std::any_of(table.rows.begin(), table.rows.end(),
                     [&](const TableRow& row) { return row.entries[column].printed.has_value(); });
}

Convergence read_convergence(const std::string& name, const fs::path& log) {
  Convergence curve{name, {}, {}, {}, {}};
  std::ifstream file(log);
  std::string line;
  std::map<std::string, std::size_t> columns;
  const auto split = [](const std::string& text) {
    std::vector<std::string> cells;
    std::istringstream stream(text);
    for (std::string cell; std::getline(stream, cell, ',');) cells.push_back(cell);
    return cells;
  };
  if (!std::getline(file, line)) return curve;
  const auto header = split(line);
  for (std::size_t i = 0; i < header.size(); ++i) columns[header[i]] = i;
  const std::pair<const char*, std::vector<double>*> wanted_columns[] = {{"minutes", &curve.minutes},
                                                                         {"psnr_db", &curve.displacement_db},
                                                                         {"psnr_normal_db", &curve.normal_db},
                                                                         {"psnr_velocity_db", &curve.velocity_db}};
  while (std::getline(file, line)) {
    const auto cells = split(line);
    double values[4];
    bool whole = true;
    for (std::size_t k = 0; k < 4; ++k) {
      const auto found = columns.find(wanted_columns[k].first);
      whole = whole && found != columns.end() && found->second < cells.size();
      values[k] = whole ? std::strtod(cells[found->second].c_str(), nullptr) : 0;
    }
    // An epoch without validation has no PSNR.
    if (!whole || !std::isfinite(values[1]) || values[1] == 0) continue;
    for (std::size_t k = 0; k < 4; ++k) wanted_columns[k].second->push_back(values[k]);
  }
  return curve;
}

PaperTables make_tables(const TablesOptions& options,
                        const std::function<void(std::uint64_t, std::uint64_t, const std::string&)>& progress) {
  std::vector<Benchmark> benchmarks;
  const fs::path folders[] = {options.draping, options.hitting, {}};
  for (std::size_t i = 0; i < std::size(kPrinted); ++i)
    benchmarks.push_back(measure(options, kPrinted[i], folders[i], progress));
  PaperTables result;
  result.tables = {table1(options, benchmarks), table2(options, benchmarks), table3(options, benchmarks)};
  result.tables.push_back(table_of_figure13(options, result.figure13));
  std::vector<Benchmark> feature_sets;
  const fs::path feature_folders[] = {options.sheet, options.disk};
  for (std::size_t i = 0; i < std::size(kFeatureSets); ++i)
    feature_sets.push_back(measure(options, kFeatureSets[i], feature_folders[i], progress));
  result.tables.push_back(table_of_features(options, feature_sets));
  for (const Benchmark& b : benchmarks) {
    if (!b.missing.empty()) continue;
    const auto bundles = wanted(options, lower(b.printed->name));
    const Wanted* own = fastest_known(b, bundles);
    const std::string own_name =
        own != nullptr && own->name != bundles[2].name && own->name != bundles[3].name ? own->name : bundles[0].name;
    result.figure11.push_back(
        pictures(b, {{"coarse", "coarse", ""},
                     {"Chen 2018", bundles[2].name, bundles[2].command},
                     {"Zurdo 2013", "zurdo2013", "a data set with sequences of the split 'train'"},
                     {"ours", own_name, bundles[0].command},
                     {"simulated", "reference", ""}}));
  }
  if (benchmarks[0].missing.empty()) {
    Panels panels{{"coarse", "coarse", ""}};
    const auto bundles = wanted(options, "draping");
    for (std::size_t i = bundles.size() - std::size(kLosses); i < bundles.size(); ++i)
      panels.push_back({bundles[i].label, bundles[i].name, bundles[i].command});
    panels.push_back({"simulated", "reference", ""});
    result.figure12.push_back(pictures(benchmarks[0], panels));
  }
  return result;
}

std::string to_text(const PaperTables& tables) {
  std::string text;
  char cell[64];
  const auto figure = [&](const std::optional<double>& value, const std::string& format) {
    if (!value) return std::string("-");
    std::snprintf(cell, sizeof cell, format.c_str(), *value);
    return std::string(cell);
  };
  for (const Table& table : tables.tables) {
    // Two lines of headings; a figure that the paper has too takes two columns.
    std::vector<std::vector<std::string>> lines(2);
    std::vector<std::size_t> pair(table.keys.size(), 1);  // columns below one heading
    for (const std::string& key : table.keys) lines[0].push_back(key), lines[1].emplace_back();
    for (std::size_t i = 0; i < table.columns.size(); ++i) {
      const bool both = has_printed(table, i);
      lines[0].push_back(table.columns[i]);
      if (both) lines[0].emplace_back(), lines[1].emplace_back("paper");
      lines[1].emplace_back("here");
      pair.push_back(both ? 2 : 1);
    }
    std::vector<std::string> commands;
    for (const TableRow& row : table.rows) {
      auto& line = lines.emplace_back(row.names);
      for (std::size_t i = 0; i < row.entries.size(); ++i) {
        const TableEntry& entry = row.entries[i];
        if (has_printed(table, i)) line.push_back(figure(entry.printed, table.formats[i]));
        line.push_back(figure(entry.measured, table.formats[i]));
        if (entry.measured || entry.missing.empty()) continue;
        const std::string command = joined(row.names) + ": " + entry.missing;
        if (std::find(commands.begin(), commands.end(), command) == commands.end()) commands.push_back(command);
      }
    }
    std::vector<std::size_t> widths(lines[1].size(), 0);
    for (std::size_t l = 1; l < lines.size(); ++l) {
      for (std::size_t i = 0; i < widths.size(); ++i) widths[i] = std::max(widths[i], lines[l][i].size());
    }
    for (std::size_t i = 0, group = 0; i < widths.size(); i += pair[group++]) {
      const std::size_t heading = lines[0][i].size(), rest = pair[group] == 2 ? widths[i + 1] + kGap : 0;
      if (widths[i] + rest < heading) widths[i] = heading - rest;
    }
    text += table.title + "\n";
    for (std::size_t l = 0; l < lines.size(); ++l) {
      std::string line;
      for (std::size_t i = 0, group = 0; i < widths.size(); i += pair[group++]) {
        for (std::size_t k = 0; k < pair[group]; ++k) {
          if (l == 0 && k > 0) continue;
          std::size_t width = widths[i + k];
          if (l == 0 && pair[group] == 2) width += widths[i + 1] + kGap;
          const std::string& value = lines[l][i + k];
          const std::string space(width > value.size() ? width - value.size() : 0, ' ');
          line += std::string(kGap, ' ') + (i < table.keys.size() ? value + space : space + value);
        }
      }
      text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
    }
    text += "  " + table.note + "\n";
    for (const std::string& command : commands) text += "  missing: " + command + "\n";
    text += "\n";
  }
  return text;
}

nlohmann::json to_json(const PaperTables& tables) {
  nlohmann::json json = nlohmann::json::object();
  const auto value = [](const std::optional<double>& v) { return v ? nlohmann::json(*v) : nlohmann::json(nullptr); };
  for (const Table& table : tables.tables) {
    nlohmann::json rows = nlohmann::json::array();
    for (const TableRow& row : table.rows) {
      nlohmann::json figures = nlohmann::json::object();
      for (std::size_t i = 0; i < row.entries.size(); ++i) {
        nlohmann::json& entry = figures[table.columns[i]];
        entry = {{"printed", value(row.entries[i].printed)}, {"measured", value(row.entries[i].measured)}};
        if (!row.entries[i].measured) entry["missing"] = row.entries[i].missing;
      }
      rows.push_back({{"names", row.names}, {"figures", std::move(figures)}});
    }
    json[table.name] = {{"title", table.title}, {"rows", std::move(rows)}, {"note", table.note}};
  }
  return json;
}

}  // namespace pleat::evaluation
