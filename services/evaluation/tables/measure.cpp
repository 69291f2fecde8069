#include "services/evaluation/tables/measure.hpp"

#include <algorithm>

#include "common/base/scratch_folder.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/rpc/channel.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/evaluation/metrics.hpp"
#include "services/evaluation/session_method.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;

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

/// Those bundles that are there, copied into a folder of their own, from which the services load them.
std::vector<Wanted> collect(const TablesOptions& options, const Request& request, const fs::path& folder) {
  std::vector<Wanted> there;
  for (const Wanted& bundle : request.bundles) {
    const fs::path models = options.models.empty() ? cli::default_models_folder() : options.models;
    fs::path file = options.trained / bundle.name / (bundle.name + ".pt");
    if (const fs::path own = models / (bundle.name + ".pt"); bundle.shipped && fs::exists(own)) file = own;
    if (!fs::exists(file)) continue;
    fs::copy_file(file, folder / (bundle.name + ".pt"));
    there.push_back(bundle);
  }
  return there;
}

/// Medians of the stages added, in ms; nothing if none of them ran.
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

bool has_examples(const DatasetReader& dataset) {
  const auto all = dataset.sequences();
  return std::any_of(all.begin(), all.end(), [](const SequenceInfo& s) { return s.split == "train"; });
}

}  // namespace

Benchmark measure(const TablesOptions& options, Request request, const TablesProgress& progress) {
  Benchmark benchmark;
  benchmark.request = std::move(request);
  const Request& asked = benchmark.request;
  if (!fs::exists(asked.dataset / "dataset.h5")) {
    benchmark.missing = asked.missing;
    return benchmark;
  }
  const DatasetReader dataset(asked.dataset);
  std::string sequence;
  std::uint64_t index = 0;
  choose_frame(dataset, options, sequence, index);
  benchmark.frame.title = asked.name + ", " + sequence + ", frame " + std::to_string(index);
  benchmark.frame.coarse_faces = dataset.topology().coarse.faces;
  benchmark.frame.fine_faces = dataset.topology().fine.faces;
  benchmark.positions["coarse"] = std::move(dataset.coarse(sequence, index, index + 1).at(0));
  benchmark.positions["reference"] = std::move(dataset.fine(sequence, index, index + 1).at(0));

  fs::create_directories(options.out);
  const ScratchFolder models(options.out, ".pleat-models");
  const std::vector<Wanted> bundles = collect(options, asked, models.path());
  std::vector<Method> methods{barycentric_method()};
  if (has_examples(dataset)) methods.push_back(zurdo_method(dataset));
  if (!asked.tracked.empty() && fs::exists(asked.tracked / "dataset.h5")) {
    if (const DatasetReader tracked(asked.tracked); has_examples(tracked)) {
      methods.push_back(zurdo_method(tracked));
      methods.back().name = "zurdo2013-tracked";
    }
  }
  std::optional<cli::Launcher> launcher;
  if (!bundles.empty()) {
    cli::LauncherOptions launch;
    launch.models = models.path();
    launch.model = bundles.front().name;
    launch.data = options.out / "services";
    launch.logs = options.out / "logs";
    launcher.emplace(launch);
    const auto client = std::make_shared<client::Client>(launcher->coordinator());
    for (const Wanted& bundle : bundles) {
      Method method = session_method(client, {.model = bundle.name, .refine = bundle.refined});
      method.name = bundle.name;
      methods.push_back(method);
    }
  }
  for (Method& method : methods) method = watched(method, sequence, index, benchmark.positions[method.name]);
  EvaluationOptions evaluation;
  evaluation.frames = options.frames;
  evaluation.every = options.every;
  for (MethodFigures& figures : evaluate(dataset, methods, evaluation, [&](std::uint64_t done, std::uint64_t total) {
         progress(done, total, asked.name);
       })) {
    const std::string name = figures.name;
    benchmark.figures.emplace(name, std::move(figures));
  }
  return benchmark;
}

std::string training(const TablesOptions& options, const std::string& name) {
  return "build/bin/pleat-train " + (options.configurations / (name + ".train.json")).string();
}

TableRow row_of_times(const Benchmark& b, const PrintedTimes& printed, const Wanted* bundle,
                      const std::string& command) {
  const std::string why = b.missing.empty() ? command : b.missing;
  const std::string no_times = b.missing.empty() ? "build/bin/pleat bench tables" : b.missing;
  const std::string name = bundle != nullptr ? bundle->name : "";
  const auto coarse = b.coarse_ms, conversion = stage(b, name, {"to_image", "to_mesh"}),
             network = stage(b, name, {"superres"}), refinement = stage(b, name, {"refinement"});
  std::optional<double> ours, speedup, coarse_vertices, fine_vertices;
  if (coarse && conversion && network && refinement) ours = *coarse + *conversion + *network + *refinement;
  if (ours && b.fine_ms) speedup = *b.fine_ms / *ours;
  if (b.missing.empty()) {
    coarse_vertices = static_cast<double>(b.positions.at("coarse").rows());
    fine_vertices = static_cast<double>(b.positions.at("reference").rows());
  }
  const auto entry = [](double figure, std::optional<double> measured, const std::string& missing) {
    return TableEntry{figure > 0 ? std::optional(figure) : std::nullopt, measured, missing};
  };
  return {{b.request.name},
          {entry(printed.coarse_vertices, coarse_vertices, b.missing),
           entry(printed.fine_vertices, fine_vertices, b.missing), entry(printed.fine_ms, b.fine_ms, no_times),
           entry(printed.ours_ms, ours, why), entry(printed.speedup, speedup, why),
           entry(printed.coarse_ms, coarse, no_times), entry(printed.conversion_ms, conversion, why),
           entry(printed.network_ms, network, why), entry(printed.refinement_ms, refinement, why)}};
}

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

}  // namespace pleat::evaluation
