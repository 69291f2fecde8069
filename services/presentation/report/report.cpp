#include "services/presentation/report/report.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <string_view>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "common/mesh/wrinkles.hpp"
#include "common/store/result.hpp"
#include "services/presentation/report/capsule_surface.hpp"
#include "services/presentation/report/upsampling.hpp"

namespace pleat::presentation {

namespace {

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const double place = share * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return std::lerp(values[below], values[above], place - static_cast<double>(below));
}

double mean(const std::vector<double>& values) {
  if (values.empty()) return 0;
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

/// Distances to the reference, over all frames and vertices.
struct Fidelity {
  double squared_sum = 0;
  double squared_max = 0;
  double count = 0;

  void add(const Positions& positions, const Positions& reference) {
    const Eigen::VectorXd squared = (positions - reference).cast<double>().rowwise().squaredNorm();
    squared_sum += squared.sum();
    squared_max = std::max(squared_max, squared.size() > 0 ? squared.maxCoeff() : 0.0);
    count += static_cast<double>(squared.size());
  }

  nlohmann::json json() const {
    return {{"rmse_m", count > 0 ? std::sqrt(squared_sum / count) : 0.0}, {"max_m", std::sqrt(squared_max)}};
  }
};

nlohmann::json make_fidelity(const ReportInput& input) {
  Fidelity enhanced;
  Fidelity upsampled;
  const std::optional<Subdivision> upsampling = find_upsampling(input.coarse_topology, input.fine_topology);
  for (std::size_t t = 0; t < input.frame_count; ++t) {
    const Positions reference = input.reference(t);
    const Positions positions = input.enhanced(t);
    if (positions.rows() != reference.rows()) {
      throw_invalid_argument("frame " + std::to_string(t) + ": the reference has " + std::to_string(reference.rows()) +
                             " vertices, the enhanced mesh " + std::to_string(positions.rows()));
    }
    enhanced.add(positions, reference);
    if (upsampling) upsampled.add(upsample(*upsampling, input.coarse_topology.faces, input.coarse(t)), reference);
  }
  nlohmann::json out = {{"enhanced", enhanced.json()}};
  if (upsampling) out["upsampled"] = upsampled.json();
  return out;
}

constexpr std::size_t kWrinkleFrames = 30;  ///< measured at most: averaging takes some 10 ms a frame

nlohmann::json make_wrinkles(const ReportInput& input) {
  std::vector<std::uint32_t> features(static_cast<std::size_t>(input.coarse_topology.vertex_count()));
  std::iota(features.begin(), features.end(), 0U);
  const WrinkleMeter meter(input.fine_topology.vertex_count(), input.fine_topology.faces, features);
  const std::size_t stride = (input.frame_count + kWrinkleFrames - 1) / kWrinkleFrames;
  const auto measure = [&](const std::function<Positions(std::size_t)>& frames) {
    std::array<double, kWrinkleBands> bands{};
    double lattice = 0, count = 0;
    for (std::size_t t = 0; t < input.frame_count; t += stride, ++count) {
      const WrinkleFigures figures = meter.measure(frames(t));
      for (std::size_t b = 0; b < kWrinkleBands; ++b) bands[b] += figures.bands[b];
      lattice += figures.lattice;
    }
    for (double& band : bands) band /= count;
    return nlohmann::json{{"bands", bands}, {"lattice", lattice / count}};
  };
  nlohmann::json out = {{"enhanced", measure(input.enhanced)}};
  if (const std::optional<Subdivision> upsampling = find_upsampling(input.coarse_topology, input.fine_topology))
    out["upsampled"] =
        measure([&](std::size_t t) { return upsample(*upsampling, input.coarse_topology.faces, input.coarse(t)); });
  if (input.reference) out["reference"] = measure(input.reference);
  return out;
}

/// HDF5 lists stages by name; people read them in the order of the pipeline. Unknown ones come last.
std::size_t place_in_pipeline(const std::string& stage) {
  static constexpr std::string_view kPipeline[] = {"simulation", "to_image",   "superres", "to_mesh",
                                                   "fold",       "refinement", "store"};
  return static_cast<std::size_t>(std::find(std::begin(kPipeline), std::end(kPipeline), stage) - std::begin(kPipeline));
}

template <class T>
std::vector<T> all_frames(std::vector<T> values, std::uint64_t frames, const std::string& name) {
  if (values.size() != frames)
    throw_data_loss(name + ": " + std::to_string(values.size()) + " values for " + std::to_string(frames) + " frames");
  return values;
}

}  // namespace

ReportInput read_report_input(const std::filesystem::path& result, ReportSummary summary) {
  const auto reader = std::make_shared<const ResultReader>(result);
  const ResultOptions& info = reader->info();
  ReportInput input;
  input.coarse_topology = info.topology.coarse;
  input.fine_topology = info.topology.fine;
  input.frame_count = static_cast<std::size_t>(info.frames);
  input.coarse = [reader](std::size_t t) { return std::move(reader->coarse(t, t + 1).at(0)); };
  input.enhanced = [reader](std::size_t t) { return std::move(reader->enhanced(t, t + 1).at(0)); };
  if (info.has_fine) input.reference = [reader](std::size_t t) { return std::move(reader->fine(t, t + 1).at(0)); };
  for (std::size_t o = 0; o < info.obstacles.size(); ++o) {
    ObstacleShape shape = info.obstacles[o];
    const bool capsules = shape.capsules > 0;
    if (capsules) shape.faces = capsule_surface_faces(std::exchange(shape.capsules, 0));
    input.obstacles.push_back({std::move(shape), [reader, o, capsules](std::size_t t) {
                                 ObstacleFrame frame = std::move(reader->obstacles(t, t + 1).at(0).at(o));
                                 if (capsules) frame.positions = capsule_surface(frame);
                                 return frame;
                               }});
  }
  for (const std::string& stage : info.stages) {
    const std::vector<float> ms = all_frames(reader->stage_ms(stage, 0, info.frames), info.frames, stage);
    input.stages.push_back({stage, {ms.begin(), ms.end()}});
  }
  std::stable_sort(input.stages.begin(), input.stages.end(), [](const ReportStage& a, const ReportStage& b) {
    return place_in_pipeline(a.name) < place_in_pipeline(b.name);
  });
  for (const std::string& count : info.counts) {
    input.counts.push_back({count, all_frames(reader->counts(count, 0, info.frames), info.frames, count)});
  }
  if (summary.model.empty()) summary.model = info.model;
  if (summary.frame_time_s <= 0) summary.frame_time_s = info.frame_time_s;
  input.summary = std::move(summary);
  return input;
}

nlohmann::json make_report_json(const ReportInput& input) {
  const ReportSummary& summary = input.summary;
  nlohmann::json out = summary.extra.is_object() ? summary.extra : nlohmann::json::object();
  out["format"] = "pleat.report";
  out["version"] = 1;
  out["title"] = summary.title;
  out["frames"] = input.frame_count;
  out["coarse_vertices"] = input.coarse_topology.vertex_count();
  out["coarse_faces"] = input.coarse_topology.face_count();
  out["fine_vertices"] = input.fine_topology.vertex_count();
  out["fine_faces"] = input.fine_topology.face_count();
  out["topology_hash"] = topology_hash(input.fine_topology);
  out["frame_time_s"] = summary.frame_time_s;
  out["wall_s"] = summary.wall_s;
  out["frames_per_s"] = summary.wall_s > 0 ? static_cast<double>(input.frame_count) / summary.wall_s : 0.0;
  out["penetrations"] = 0;
  out["self_intersections"] = 0;
  for (const ReportCount& count : input.counts) {
    out[count.name] = std::accumulate(count.values.begin(), count.values.end(), std::uint64_t{0});
  }
  nlohmann::json stages = nlohmann::json::object();
  for (const ReportStage& stage : input.stages) {
    if (stage.ms.size() != input.frame_count) {
      throw_invalid_argument("stage " + stage.name + " has " + std::to_string(stage.ms.size()) + " times for " +
                             std::to_string(input.frame_count) + " frames");
    }
    stages[stage.name] = {{"median_ms", percentile(stage.ms, 0.5)},
                          {"p95_ms", percentile(stage.ms, 0.95)},
                          {"mean_ms", mean(stage.ms)},
                          {"max_ms", percentile(stage.ms, 1.0)}};
  }
  out["stages"] = std::move(stages);
  out["model"] = summary.model;
  out["device"] = summary.device;
  out["precision"] = summary.precision;
  if (!summary.git_revision.empty()) out["git_revision"] = summary.git_revision;
  if (input.reference) out["fidelity"] = make_fidelity(input);
  if (input.frame_count > 0) out["wrinkles"] = make_wrinkles(input);
  return out;
}

void write_report_json(const ReportInput& input, const std::filesystem::path& path) {
  write_whole_file(path, make_report_json(input).dump(2) + "\n");
}

}  // namespace pleat::presentation
