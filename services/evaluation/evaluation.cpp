#include "services/evaluation/evaluation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/refinement/judge.hpp"
#include "services/superres/zurdo.hpp"

namespace pleat::evaluation {
namespace {

constexpr const char* kUpsamplingMethod = "barycentric";

}  // namespace

std::vector<SequenceInfo> chosen_sequences(const DatasetReader& dataset, const std::vector<std::string>& names) {
  std::vector<SequenceInfo> all = dataset.sequences(), chosen;
  std::erase_if(all, [](const SequenceInfo& info) { return info.frames_complete == 0; });
  for (const std::string& name : names) {
    const auto found =
        std::find_if(all.begin(), all.end(), [&](const SequenceInfo& info) { return info.name == name; });
    if (found == all.end()) throw_not_found(dataset.folder().string() + ": no sequence '" + name + "' with frames");
    chosen.push_back(*found);
  }
  if (names.empty()) {
    std::copy_if(all.begin(), all.end(), std::back_inserter(chosen),
                 [](const SequenceInfo& info) { return info.split == "test"; });
    if (chosen.empty()) chosen = all;
  }
  if (chosen.empty()) throw_not_found(dataset.folder().string() + ": no sequence with frames");
  return chosen;
}

SubdivisionSpec subdivision_of(const MeshPair& topology) {
  const auto spec = find_subdivision(topology.coarse, topology.fine);
  if (!spec) throw_invalid_argument("the fine mesh of the data set is not a subdivision of its coarse mesh");
  return *spec;
}

Method barycentric_method() {
  return {kUpsamplingMethod, [](const MethodInput& input, const auto& sink) {
            const Topology& coarse = input.meshes->coarse;
            const Subdivision subdivision = subdivide(coarse, subdivision_of(*input.meshes));
            for (std::uint64_t k = 0; k < input.frames; ++k)
              sink(k, MethodFrame{upsample(subdivision, coarse.faces, input.coarse(k)), {}});
          }};
}

Method zurdo_method(const DatasetReader& dataset) {
  const auto wrinkles = std::make_shared<superres::ZurdoWrinkles>(superres::train_zurdo(dataset));
  return {"zurdo2013", [wrinkles](const MethodInput& input, const auto& sink) {
            for (std::uint64_t k = 0; k < input.frames; ++k) {
              const Positions coarse = input.coarse(k);
              const auto start = std::chrono::steady_clock::now();
              MethodFrame frame{wrinkles->synthesize(coarse), {}};
              const std::chrono::duration<double, std::milli> taken = std::chrono::steady_clock::now() - start;
              frame.ms = {{"examples", taken.count()}};
              sink(k, frame);
            }
          }};
}

namespace {

/// Sequences by their meshes, in the order of the first of each.
struct Garment {
  std::shared_ptr<const MeshPair> meshes;
  bool own = false;  ///< not the data set's
  std::vector<SequenceInfo> sequences;
};

std::vector<Garment> garments_of(const DatasetReader& dataset, std::vector<SequenceInfo> sequences) {
  std::vector<Garment> garments;
  std::map<std::string, std::size_t> known;
  const std::string hash = topology_hash(dataset.topology().fine);
  for (SequenceInfo& info : sequences) {
    const auto [at, is_new] = known.try_emplace(info.topology_hash, garments.size());
    if (is_new) garments.push_back({dataset.meshes(info.name), info.topology_hash != hash, {}});
    garments[at->second].sequences.push_back(std::move(info));
  }
  return garments;
}

std::uint64_t frames_of(const EvaluationOptions& options, const SequenceInfo& info) {
  return options.frames > 0 ? std::min(options.frames, info.frames_complete) : info.frames_complete;
}

MethodFigures run_method(const DatasetReader& dataset, const Method& method, const Garment& garment,
                         const EvaluationOptions& options, const std::function<void()>& frame_done) {
  const MeshPair& meshes = *garment.meshes;
  const std::uint64_t every = std::max<std::uint64_t>(1, options.every);
  MetricsAccumulator metrics(meshes.coarse, meshes.fine, meshes.feature_vertices,
                             garment.own ? std::nullopt : dataset.master().normalization);
  std::vector<std::pair<std::string, std::vector<double>>> times;
  for (const SequenceInfo& info : garment.sequences) {
    metrics.begin_sequence();
    MethodInput input;
    input.sequence = info.name;
    input.meshes = garment.meshes;
    input.frames = frames_of(options, info);
    input.frame_time_s = dataset.master().frame_time_s;
    input.scene = info.scene;
    input.material = dataset.master().material;
    input.obstacle_shapes = info.obstacles;
    input.coarse = [&](std::uint64_t k) { return std::move(dataset.coarse(info.name, k, k + 1).at(0)); };
    input.obstacles = [&](std::uint64_t k) { return std::move(dataset.obstacles(info.name, k, k + 1).at(0)); };
    method.run(input, [&](std::uint64_t k, const MethodFrame& frame) {
      for (const auto& [stage, ms] : frame.ms) {
        const auto found =
            std::find_if(times.begin(), times.end(), [&, &name = stage](const auto& t) { return t.first == name; });
        if (found == times.end())
          times.push_back({stage, {ms}});
        else
          found->second.push_back(ms);
      }
      frame_done();
      if (k % every != 0) return;
      const Positions reference = std::move(dataset.fine(info.name, k, k + 1).at(0));
      const auto obstacles = input.obstacles(k);
      FrameCounts counts;
      counts.penetrations =
          refinement::count_penetrations(frame.positions, meshes.fine.faces, info.obstacles, obstacles);
      counts.self_intersections = refinement::count_self_intersections(frame.positions, meshes.fine.faces);
      counts.penetrations_before = frame.refined ? frame.penetrations_before : counts.penetrations;
      counts.self_intersections_before = frame.refined ? frame.self_intersections_before : counts.self_intersections;
      metrics.add(input.coarse(k), reference, frame.positions, counts);
    });
  }
  MethodFigures result{method.name, metrics.values(), {}};
  for (auto& [stage, ms] : times) result.median_ms.emplace_back(stage, median(std::move(ms)));
  return result;
}

}  // namespace

std::vector<GarmentFigures> evaluate_garments(const DatasetReader& dataset, const std::vector<Method>& methods,
                                              const EvaluationOptions& options,
                                              const std::function<void(std::uint64_t, std::uint64_t)>& progress) {
  const std::vector<SequenceInfo> sequences = chosen_sequences(dataset, options.sequences);
  std::uint64_t total = 0, done = 0;
  for (const SequenceInfo& info : sequences) total += frames_of(options, info) * methods.size();
  std::vector<GarmentFigures> all;
  for (const Garment& garment : garments_of(dataset, sequences)) {
    GarmentFigures& figures = all.emplace_back();
    figures.meshes = garment.meshes;
    for (const SequenceInfo& info : garment.sequences) figures.sequences.push_back(info.name);
    for (const Method& method : methods)
      figures.methods.push_back(run_method(dataset, method, garment, options, [&] { progress(++done, total); }));
  }
  return all;
}

std::vector<MethodFigures> evaluate(const DatasetReader& dataset, const std::vector<Method>& methods,
                                    const EvaluationOptions& options,
                                    const std::function<void(std::uint64_t, std::uint64_t)>& progress) {
  const auto garments = garments_of(dataset, chosen_sequences(dataset, options.sequences));
  if (garments.size() > 1) {
    throw_invalid_argument(dataset.folder().string() + ": sequences " + garments[0].sequences[0].name + " and " +
                           garments[1].sequences[0].name + " have different meshes; these figures are of one");
  }
  return std::move(evaluate_garments(dataset, methods, options, progress).front().methods);
}

namespace {

/// What upsampling lacks, root mean square: the size of the detail that there is to make. Absent without that method.
std::optional<double> reference_detail(const std::vector<MethodFigures>& figures) {
  const auto found = std::find_if(figures.begin(), figures.end(),
                                  [](const MethodFigures& method) { return method.name == kUpsamplingMethod; });
  if (found == figures.end()) return std::nullopt;
  return found->metrics.rmse_m;
}

const MethodFigures* figures_of(const GarmentFigures& garment, const std::string& method) {
  const auto found = std::find_if(garment.methods.begin(), garment.methods.end(),
                                  [&](const MethodFigures& figures) { return figures.name == method; });
  return found == garment.methods.end() ? nullptr : &*found;
}

/// A method's gains over upsampling on several garments.
struct Gains {
  std::string method;
  std::vector<std::optional<double>> db;  ///< per garment
  std::optional<double> mean;             ///< over those that have one
  std::size_t least = 0;                  ///< the garment with the least, where there is a mean
};

std::vector<Gains> gains_of(const std::vector<GarmentFigures>& garments) {
  std::vector<Gains> all;
  for (const MethodFigures& method : garments.front().methods) {
    if (method.name == kUpsamplingMethod) continue;
    Gains& gains = all.emplace_back();
    gains.method = method.name;
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < garments.size(); ++i) {
      const auto db = gains.db.emplace_back(gain_db(garments[i], method.name));
      if (!db) continue;
      if (count == 0 || *db < *gains.db[gains.least]) gains.least = i;
      sum += *db;
      ++count;
    }
    if (count > 0) gains.mean = sum / static_cast<double>(count);
  }
  return all;
}

}  // namespace

std::optional<double> gain_db(const GarmentFigures& garment, const std::string& method) {
  const MethodFigures *upsampling = figures_of(garment, kUpsamplingMethod), *other = figures_of(garment, method);
  if (upsampling == nullptr || other == nullptr) return std::nullopt;
  const double before = upsampling->metrics.vmse_m2, after = other->metrics.vmse_m2;
  if (before <= 0 || after <= 0) return std::nullopt;
  return 10 * std::log10(before / after);
}

nlohmann::json to_json(const std::vector<GarmentFigures>& garments) {
  if (garments.size() == 1) return to_json(garments.front().methods);
  nlohmann::json json = {{"garments", nlohmann::json::array()}, {"gain_db", nlohmann::json::object()}};
  for (const GarmentFigures& garment : garments) {
    json["garments"].push_back({{"sequences", garment.sequences},
                                {"coarse_vertices", garment.meshes->coarse.vertex_count()},
                                {"fine_vertices", garment.meshes->fine.vertex_count()},
                                {"methods", to_json(garment.methods)}});
  }
  for (const Gains& gains : gains_of(garments)) {
    if (!gains.mean) continue;
    json["gain_db"][gains.method] = {{"mean", *gains.mean},
                                     {"least", *gains.db[gains.least]},
                                     {"least_of", garments[gains.least].sequences.front()}};
  }
  return json;
}

nlohmann::json to_json(const std::vector<MethodFigures>& figures) {
  nlohmann::json json = nlohmann::json::object();
  const std::optional<double> detail = reference_detail(figures);
  for (const MethodFigures& method : figures) {
    const MetricValues& m = method.metrics;
    nlohmann::json& out = json[method.name];
    out["frames"] = m.frames;
    out["psnr_db"] = m.psnr_db ? nlohmann::json(*m.psnr_db) : nlohmann::json(nullptr);
    out["vmse_m2"] = m.vmse_m2;
    out["rmse_m"] = m.rmse_m;
    out["rmse_relative"] = m.rmse_relative;
    out["hausdorff_m"] = m.hausdorff_m;
    out["normal_angle_deg"] = m.normal_angle_deg;
    out["stretch"] = m.stretch;
    out["sted"] = m.sted.combined;
    out["sted_spatial"] = m.sted.spatial;
    out["sted_temporal"] = m.sted.temporal;
    out["jitter"] = m.jitter_m;
    out["jitter_ratio"] = m.jitter_ratio;
    out["wrinkles"] = m.wrinkles;
    out["lattice"] = m.lattice;
    out["lattice_reference"] = m.reference_lattice;
    if (detail) out["detail_rmse_m"] = *detail;
    out["penetrations"] = m.counts.penetrations;
    out["penetrations_before"] = m.counts.penetrations_before;
    out["self_intersections"] = m.counts.self_intersections;
    out["self_intersections_before"] = m.counts.self_intersections_before;
    for (const auto& [stage, ms] : method.median_ms) out[stage + "_ms"] = ms;
  }
  return json;
}

std::string to_table(const std::vector<MethodFigures>& figures) {
  std::string table;
  char line[320];
  std::snprintf(line, sizeof line, "%-24s %6s %8s %10s %8s %8s %9s %8s %9s %9s %9s %9s %15s %15s\n", "method", "frames",
                "PSNR dB", "VMSE m^2", "RMSE mm", "RMSE/box", "Hausd. mm", "normal", "stretch", "STED", "jitter mm",
                "/ refer.", "penetrations", "self-inters.");
  table += line;
  const auto change = [](std::uint64_t before, std::uint64_t after) {
    return before == after ? std::to_string(after) : std::to_string(before) + " > " + std::to_string(after);
  };
  for (const MethodFigures& method : figures) {
    const MetricValues& m = method.metrics;
    char psnr[16] = "-";
    if (m.psnr_db) std::snprintf(psnr, sizeof psnr, "%.2f", *m.psnr_db);
    std::snprintf(line, sizeof line,
                  "%-24s %6zu %8s %10.3e %8.3f %8.5f %9.3f %7.2f\u00b0 %9.5f %9.5f %9.4f %9.3f %15s %15s\n",
                  method.name.c_str(), m.frames, psnr, m.vmse_m2, 1e3 * m.rmse_m, m.rmse_relative, 1e3 * m.hausdorff_m,
                  m.normal_angle_deg, m.stretch, m.sted.combined, 1e3 * m.jitter_m, m.jitter_ratio,
                  change(m.counts.penetrations_before, m.counts.penetrations).c_str(),
                  change(m.counts.self_intersections_before, m.counts.self_intersections).c_str());
    table += line;
  }
  table += "\nwrinkles: energy of the normals over the reference's, by band of averaging rounds; 1 is right\n";
  std::snprintf(line, sizeof line, "%-24s %8s %8s %8s %8s %8s\n", "method", "0-1", "1-4", "4-16", "16-64", "lattice");
  table += line;
  for (const MethodFigures& method : figures) {
    const MetricValues& m = method.metrics;
    std::snprintf(line, sizeof line, "%-24s %8.3f %8.3f %8.3f %8.3f %8.3f\n", method.name.c_str(), m.wrinkles[0],
                  m.wrinkles[1], m.wrinkles[2], m.wrinkles[3], m.lattice);
    table += line;
  }
  if (!figures.empty()) {
    std::snprintf(line, sizeof line, "%-24s %8s %8s %8s %8s %8.3f\n", "reference", "1", "1", "1", "1",
                  figures.front().metrics.reference_lattice);
    table += line;
  }
  if (const std::optional<double> detail = reference_detail(figures)) {
    std::snprintf(line, sizeof line, "the reference's own detail, which upsampling lacks: %.3f mm RMS\n",
                  1e3 * *detail);
    table += line;
  }
  for (const MethodFigures& method : figures) {
    if (method.median_ms.empty()) continue;
    table += method.name + ", median ms a frame:";
    for (const auto& [stage, ms] : method.median_ms) {
      std::snprintf(line, sizeof line, " %s %.2f", stage.c_str(), ms);
      table += line;
    }
    table += "\n";
  }
  return table;
}

std::string to_table(const std::vector<GarmentFigures>& garments) {
  if (garments.size() == 1) return to_table(garments.front().methods);
  std::string table;
  char line[320];
  for (const GarmentFigures& garment : garments) {
    std::snprintf(
        line, sizeof line, "%s%s, %td > %td vertices\n", garment.sequences.front().c_str(),
        garment.sequences.size() > 1 ? (" and " + std::to_string(garment.sequences.size() - 1) + " more").c_str() : "",
        garment.meshes->coarse.vertex_count(), garment.meshes->fine.vertex_count());
    table += line + to_table(garment.methods) + "\n";
  }
  table += "gain over upsampling in VMSE, dB: mean and least over the garments\n";
  for (const Gains& gains : gains_of(garments)) {
    if (!gains.mean) continue;
    std::snprintf(line, sizeof line, "%-24s %8.2f %8.2f (%s)\n", gains.method.c_str(), *gains.mean,
                  *gains.db[gains.least], garments[gains.least].sequences.front().c_str());
    table += line;
  }
  return table;
}

}  // namespace pleat::evaluation
