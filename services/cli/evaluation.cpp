#include "services/cli/evaluation.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/cli/median.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::cli {
namespace {

constexpr int kMaxRounds = 5;

std::vector<SequenceInfo> choose_sequences(const DatasetReader& dataset, const std::vector<std::string>& names) {
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

}  // namespace

int subdivision_rounds(const MeshPair& topology) {
  Eigen::Index faces = topology.coarse.face_count();
  for (int rounds = 0; rounds <= kMaxRounds && faces <= topology.fine.face_count(); ++rounds, faces *= 4) {
    if (faces == topology.fine.face_count() &&
        topology_hash(subdivide(topology.coarse, rounds).fine) == topology_hash(topology.fine))
      return rounds;
  }
  throw_invalid_argument("the fine mesh of the data set is not the subdivision of its coarse mesh");
}

Method barycentric_method(const MeshPair& topology) {
  const auto subdivision = std::make_shared<Subdivision>(subdivide(topology.coarse, subdivision_rounds(topology)));
  return {"barycentric", [subdivision, faces = topology.coarse.faces](const MethodInput& input, const auto& sink) {
            for (std::uint64_t k = 0; k < input.frames; ++k)
              sink(k, MethodFrame{upsample(*subdivision, faces, input.coarse(k)), {}});
          }};
}

std::vector<MethodFigures> evaluate(const DatasetReader& dataset, const std::vector<Method>& methods,
                                    const EvaluationOptions& options,
                                    const std::function<void(std::uint64_t, std::uint64_t)>& progress) {
  const std::vector<SequenceInfo> sequences = choose_sequences(dataset, options.sequences);
  const MeshPair& topology = dataset.topology();
  std::optional<DisplacementRange> range;
  if (const auto& normalization = dataset.master().normalization) {
    range.emplace();
    for (std::size_t c = 0; c < 3; ++c) {
      range->minimum[c] = normalization->minimum[c];
      range->maximum[c] = normalization->maximum[c];
    }
  }
  const auto frames_of = [&options](const SequenceInfo& info) {
    return options.frames > 0 ? std::min(options.frames, info.frames_complete) : info.frames_complete;
  };
  std::uint64_t total = 0, done = 0;
  for (const SequenceInfo& info : sequences) total += frames_of(info) * methods.size();

  std::vector<MethodFigures> figures;
  for (const Method& method : methods) {
    MetricsAccumulator metrics(topology.coarse, topology.fine, range);
    std::vector<std::pair<std::string, std::vector<double>>> times;
    for (const SequenceInfo& info : sequences) {
      metrics.begin_sequence();
      MethodInput input;
      input.sequence = info.name;
      input.frames = frames_of(info);
      input.frame_time_s = dataset.master().frame_time_s;
      input.obstacle_shapes = info.obstacles;
      input.coarse = [&](std::uint64_t k) { return std::move(dataset.coarse(info.name, k, k + 1).at(0)); };
      input.obstacles = [&](std::uint64_t k) { return std::move(dataset.obstacles(info.name, k, k + 1).at(0)); };
      method.run(input, [&](std::uint64_t k, const MethodFrame& frame) {
        const Positions reference = std::move(dataset.fine(info.name, k, k + 1).at(0));
        const auto obstacles = input.obstacles(k);
        metrics.add(input.coarse(k), reference, frame.positions,
                    count_penetrations(frame.positions, topology.fine.faces, info.obstacles, obstacles),
                    count_self_intersections(frame.positions, topology.fine.faces));
        for (const auto& [stage, ms] : frame.ms) {
          const auto found =
              std::find_if(times.begin(), times.end(), [&, &name = stage](const auto& t) { return t.first == name; });
          if (found == times.end())
            times.push_back({stage, {ms}});
          else
            found->second.push_back(ms);
        }
        progress(++done, total);
      });
    }
    MethodFigures result{method.name, metrics.values(), {}};
    for (auto& [stage, ms] : times) result.median_ms.emplace_back(stage, median(std::move(ms)));
    figures.push_back(std::move(result));
  }
  return figures;
}

nlohmann::json to_json(const std::vector<MethodFigures>& figures) {
  nlohmann::json json = nlohmann::json::object();
  for (const MethodFigures& method : figures) {
    const MetricValues& m = method.metrics;
    nlohmann::json& out = json[method.name];
    out["frames"] = m.frames;
    out["psnr_db"] = m.psnr_db ? nlohmann::json(*m.psnr_db) : nlohmann::json(nullptr);
    out["vmse_m2"] = m.vmse_m2;
    out["rmse_m"] = m.rmse_m;
    out["hausdorff_m"] = m.hausdorff_m;
    out["sted"] = m.sted.combined;
    out["sted_spatial"] = m.sted.spatial;
    out["sted_temporal"] = m.sted.temporal;
    out["jitter"] = m.jitter_m;
    out["penetrations"] = m.penetrations;
    out["self_intersections"] = m.self_intersections;
    for (const auto& [stage, ms] : method.median_ms) out[stage + "_ms"] = ms;
  }
  return json;
}

std::string to_table(const std::vector<MethodFigures>& figures) {
  std::string table;
  char line[256];
  std::snprintf(line, sizeof line, "%-24s %7s %9s %11s %10s %12s %9s %11s %6s %9s\n", "method", "frames", "PSNR dB",
                "VMSE m^2", "RMSE mm", "Hausdorff mm", "STED", "jitter mm", "penet.", "self-int.");
  table += line;
  for (const MethodFigures& method : figures) {
    const MetricValues& m = method.metrics;
    char psnr[16] = "-";
    if (m.psnr_db) std::snprintf(psnr, sizeof psnr, "%.2f", *m.psnr_db);
    std::snprintf(line, sizeof line, "%-24s %7zu %9s %11.3e %10.3f %12.3f %9.5f %11.4f %6llu %9llu\n",
                  method.name.c_str(), m.frames, psnr, m.vmse_m2, 1e3 * m.rmse_m, 1e3 * m.hausdorff_m, m.sted.combined,
                  1e3 * m.jitter_m, static_cast<unsigned long long>(m.penetrations),
                  static_cast<unsigned long long>(m.self_intersections));
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

}  // namespace pleat::cli
