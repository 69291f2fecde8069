// What a run leaves behind for people: report.json (figures) and report.html (the cloth in 3D, self-contained).
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "services/simulation/body/motion.hpp"
#include "services/simulation/body/skinned_mesh.hpp"

namespace pleat::presentation {

/// Per-frame time of one stage; stages keep the order of the pipeline.
struct ReportStage {
  std::string name;
  std::vector<double> ms;  ///< (T) milliseconds, one per frame
};

/// How the vertices of an obstacle follow joints: linear blend skinning, frame k of the motion in frame k.
struct ReportSkin {
  body::SkinnedMesh mesh;
  body::Motion motion;  ///< of the mesh's skeleton; its last frame stays
};

/// An obstacle and its state in every frame.
struct ReportObstacle {
  ObstacleShape shape;
  std::function<ObstacleFrame(std::size_t frame)> at;
  /// Where known, the page gets this and skins the body itself; frames in which `at` is elsewhere have their points.
  std::shared_ptr<const ReportSkin> skin = nullptr;
};

/// A number per frame besides the times, for example penetrations or self_intersections.
struct ReportCount {
  std::string name;
  std::vector<std::uint32_t> values;  ///< (T)
};

/// The figures that the result file does not hold.
struct ReportSummary {
  std::string title = "Pleat";        ///< for example the name of the scene
  std::string model;                  ///< name of the model bundle; read_report_input takes the file's if empty
  std::string device = "cpu";         ///< what superres ran on
  std::string precision = "float32";  ///< float32 or bfloat16
  std::string git_revision;           ///< empty: left out
  double wall_s = 0;                  ///< from the first frame asked to the last frame stored
  double frame_time_s = 0;            ///< seconds of the scene between two frames
  nlohmann::json extra = nlohmann::json::object();  ///< further top-level fields of report.json; own fields win
};

/// Everything a report shows. Frames are read through functions, so that a long result never lies in memory whole.
struct ReportInput {
  Topology coarse_topology;
  Topology fine_topology;
  std::size_t frame_count = 0;                            ///< T
  std::function<Positions(std::size_t frame)> coarse;     ///< (V_coarse x 3) metres
  std::function<Positions(std::size_t frame)> enhanced;   ///< (V_fine x 3) metres
  std::function<Positions(std::size_t frame)> reference;  ///< (V_fine x 3) metres; empty if none was simulated
  std::vector<ReportObstacle> obstacles;
  std::vector<ReportStage> stages;
  std::vector<ReportCount> counts;  ///< their sums become top-level fields of report.json
  ReportSummary summary;
};

/// Opens result.h5 (finished or .partial); frames are read from it while the report is written. The file's model and
/// frame time fill those of `summary` that are empty or 0. Errors as ResultReader.
ReportInput read_report_input(const std::filesystem::path& result, ReportSummary summary);

/// Limits of report.html.
struct ReportHtmlOptions {
  std::size_t max_bytes = 40'000'000;  ///< above it every 2nd, 3rd, ... frame is shown; stage times stay complete
};

/// The content of report.json (docs/report.md): frames, coarse_vertices, fine_vertices, wall_s, frames_per_s,
/// stages {name: {median_ms, p95_ms, mean_ms, max_ms}}, the sum of each count (penetrations and self_intersections are
/// 0 where they were not counted), model, device, precision; with a reference also fidelity {enhanced, upsampled:
/// {rmse_m, max_m}}; wrinkles {enhanced, upsampled, reference: {bands, lattice}} (common/mesh/wrinkles.hpp).
/// Percentiles interpolate linearly between order statistics. Throws kInvalidArgument if a stage has another number of
/// frames. O(T V).
nlohmann::json make_report_json(const ReportInput& input);

/// Writes make_report_json to `path` (through a temporary file and a rename). Throws kResourceExhausted (disk).
void write_report_json(const ReportInput& input, const std::filesystem::path& path);

/// Writes the self-contained page to `path`: the viewer with topologies, frames, obstacles and times inside it.
/// Positions are quantised to 16 bits of the largest frame bounding box (1.5 m cloth: 23 um), stored as differences in
/// time and deflated; of a skinned obstacle mesh, weights and joints. Throws kInvalidArgument (frame sizes),
/// kResourceExhausted (disk, or one frame above max_bytes).
void write_report_html(const ReportInput& input, const std::filesystem::path& path,
                       const ReportHtmlOptions& options = {});

}  // namespace pleat::presentation
