// Benchmarks: medians of runs on this machine, with what they include said in docs/cli.md.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

namespace pleat::evaluation {

struct Figure {
  double median = 0;
  std::size_t runs = 0;
  std::string unit;
};

/// Figures in the order in which they are shown.
using Figures = std::vector<std::pair<std::string, Figure>>;

struct BenchOptions {
  std::filesystem::path scene;              ///< empty: deploy/scenes/draping.json, for refinement hitting.json
  std::filesystem::path models;             ///< empty: default_models_folder()
  std::filesystem::path out = "out/bench";  ///< logs and the files of jobs
  std::filesystem::path dataset;            ///< conversion and refinement: its frames; empty: frames made on the spot
  std::string model;                        ///< refinement: the bundle for the data set's frames; empty: the default
  std::size_t frames = 40;                  ///< frames (or runs) of one figure; costly ones take a quarter
};

/// coarse_frame, tracked_frame, fine_frame (ms): whole frames of the scene, steps, contact and obstacles included.
Figures bench_simulation(const BenchOptions& options);
/// One of them alone, over options.frames frames.
Figure coarse_frame_time(const BenchOptions& options);
Figure tracked_frame_time(const BenchOptions& options);
/// to_image, to_mesh, build_map (ms); round_trip_rms, round_trip_max (m), over all frames; and their tables
/// round_trip_rms/METHOD/SIZE, where SIZE is texels per fine vertex or the published 768x512 (a tenth of the frames),
/// and skirt/... of that garment. Frames: of the data set, or the scene's garment with wrinkles.
Figures bench_conversion(const BenchOptions& options);
/// infer (ms) of the default bundle as the service chooses, and infer/BUNDLE/PRECISION for every bundle and precision
/// that this machine has; measured inside the service, without transport.
Figures bench_superres(const BenchOptions& options);
/// refine, refine_p95 (ms), what the judge counts before and after, how far vertices move, and with a data set the
/// displacement PSNR before and after, over the frames of visit_refinement_inputs().
Figures bench_refinement(const BenchOptions& options);
/// frames_per_s of a whole job, latency (ms) of a live session with one frame in flight, transport_share of it, with
/// the default bundle; and fold/... of each with the fold step instead.
Figures bench_pipeline(const BenchOptions& options);

/// The scene asked for, or the one in deploy/scenes with this name.
std::filesystem::path scene_or(const BenchOptions& options, const std::string& name);

/// {name: {figure: {median, runs, unit}}}.
nlohmann::json to_json(const std::string& name, const Figures& figures);

}  // namespace pleat::evaluation
