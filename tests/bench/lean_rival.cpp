// bench_lean_rival: the leanest direct simulation of the fine sheet against Pleat's coarse and tracked simulation of
// the same scene, or with --rounds against whole jobs at several sizes, in one run. A measurement, not a test.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/machine.hpp"
#include "common/base/signals.hpp"
#include "common/base/statistics.hpp"
#include "services/evaluation/job_cost.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/refinement/judge.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/bench/rivals/lean_cloth.hpp"

namespace {

using nlohmann::json;
using pleat::Positions;
using pleat::simulation::Mode;
using pleat::simulation::Scene;
using pleat::simulation::SimulatedFrame;
using pleat::simulation::Simulation;
using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

struct Run {
  std::vector<double> frame_ms;
  std::size_t intersections = 0, dirty_frames = 0;
  Positions last;

  void judge(const Positions& positions, const pleat::Faces& faces) {
    const std::size_t found = pleat::refinement::count_self_intersections(positions, faces);
    intersections += found;
    dirty_frames += found > 0 ? 1 : 0;
    last = positions;
  }
};

Run run_lean(const Scene& scene, const pleat::Topology& fine, const Positions& start,
             const pleat::bench::LeanOptions& options, int frames) {
  pleat::bench::LeanCloth cloth(scene, fine, start, options);
  Run run;
  for (int k = 0; k < frames; ++k) {
    const auto begin = Clock::now();
    cloth.frame();
    run.frame_ms.push_back(milliseconds_since(begin));
    run.judge(cloth.positions(), fine.faces);
  }
  return run;
}

Run run_engine(Scene scene, Mode mode, int frames) {
  scene.frames = frames + 1;
  Simulation simulation(std::move(scene), mode);
  const pleat::Faces faces = mode == Mode::kCoarse ? simulation.coarse().faces : simulation.fine().faces;
  Run run;
  simulation.next_frame();
  for (int k = 0; k < frames; ++k) {
    const auto begin = Clock::now();
    const SimulatedFrame frame = simulation.next_frame();
    run.frame_ms.push_back(milliseconds_since(begin));
    run.judge(frame.fine ? frame.fine->positions : frame.coarse.positions, faces);
  }
  return run;
}

void write_json(const std::string& file, json figures) {
  if (file.empty()) return;
  std::ofstream(file) << json{{"lean_rival", std::move(figures)},
                              {"machine", pleat::machine_info()},
                              {"git_revision", pleat::git_revision()}}
                             .dump(2)
                      << "\n";
}

struct Sizes {
  std::vector<int> rounds;
  std::vector<std::string> bundles;  ///< one for each, or one for all
  std::vector<std::string> details;
  pleat::evaluation::JobCostOptions job;
};

/// One size. The rival keeps its sub-steps, although a finer sheet needs more of them to be as stiff: it is only faster
/// so. Its particles keep a distance that shrinks with the edges.
void measure_size(pleat::v1::Scene message, int rounds, const Sizes& sizes, const std::string& bundle,
                  pleat::bench::LeanOptions options, std::size_t frames, json& figures) {
  message.set_subdivision_rounds(static_cast<std::uint32_t>(rounds));
  Scene scene = pleat::simulation::scene_from_message(message);
  scene.threads = static_cast<int>(options.threads);
  scene.frames = 1;
  Simulation simulation(scene, Mode::kCoarse);
  const pleat::Topology& coarse = simulation.coarse();
  const pleat::Subdivision subdivision = pleat::subdivide(coarse, rounds);
  const Positions start = pleat::upsample(subdivision, coarse.faces, simulation.next_frame().coarse.positions);
  options.radius_m *= std::pow(0.5, rounds - pleat::kDefaultSubdivisionRounds);
  pleat::bench::LeanCloth cloth(scene, subdivision.fine, start, options);
  std::vector<double> lean_ms;
  for (std::size_t k = 0; k < frames && !pleat::interrupted(); ++k) {
    const auto begin = Clock::now();
    cloth.frame();
    lean_ms.push_back(milliseconds_since(begin));
  }
  const double lean = 1e3 / pleat::median(lean_ms);
  const std::string size = std::to_string(subdivision.fine.vertex_count());
  std::printf("%s vertices: lean XPBD %.2f frames/s\n", size.c_str(), lean);
  figures[size + "/lean_frames_per_s"] = {{"median", lean}, {"runs", lean_ms.size()}, {"unit", "1/s"}};
  for (const std::string& detail : sizes.details) {
    pleat::evaluation::JobCostOptions job = sizes.job;
    job.detail = detail == "fold" ? pleat::v1::DETAIL_FOLD : pleat::v1::DETAIL_NETWORK;
    job.model = bundle;
    const pleat::evaluation::JobCost cost = pleat::evaluation::job_cost(message, job);
    const std::string name = size + "/" + detail + "/";
    std::printf("  %-8s %8.2f frames/s, %6.1f times the lean rival's; peak MiB:", detail.c_str(), cost.frames_per_s,
                cost.frames_per_s / lean);
    double total = 0;
    for (const auto& [service, mib] : cost.peak_mib) {
      std::printf(" %s %.0f", service.c_str(), mib);
      figures[name + "peak_memory/" + service] = {{"median", mib}, {"runs", 1}, {"unit", "MiB"}};
      total += mib;
    }
    std::printf(", all %.0f\n", total);
    std::fflush(stdout);
    figures[name + "frames_per_s"] = {{"median", cost.frames_per_s}, {"runs", cost.runs}, {"unit", "1/s"}};
    figures[name + "over_lean"] = {{"median", cost.frames_per_s / lean}, {"runs", cost.runs}, {"unit", "1"}};
  }
}

int measure_sizes(const std::string& scene_file, const Sizes& sizes, const pleat::bench::LeanOptions& options,
                  int frames, const std::string& json_file) {
  const pleat::v1::Scene scene = pleat::presentation::read_scene_file(scene_file);
  json figures;
  for (std::size_t i = 0; i < sizes.rounds.size(); ++i) {
    const std::string bundle = sizes.bundles.empty() ? "" : sizes.bundles[std::min(i, sizes.bundles.size() - 1)];
    measure_size(scene, sizes.rounds[i], sizes, bundle, options, static_cast<std::size_t>(frames), figures);
  }
  write_json(json_file, std::move(figures));
  return 0;
}

int measure(const std::string& scene_file, pleat::bench::LeanOptions options, int frames,
            const std::string& json_file) {
  Scene scene = pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
  scene.threads = static_cast<int>(options.threads);
  scene.frames = 1;
  Simulation simulation(scene, Mode::kTrackedFine);
  const pleat::Topology fine = simulation.fine();
  const Positions start = simulation.next_frame().fine->positions;

  struct Row {
    const char *name, *figure;
    Run run;
  };
  const double radius = options.radius_m;
  std::vector<Row> rows;
  rows.push_back({"lean XPBD, fine, with self-collision", "lean_frame", run_lean(scene, fine, start, options, frames)});
  options.radius_m = 0;
  rows.push_back(
      {"lean XPBD, fine, without", "lean_frame_without_collision", run_lean(scene, fine, start, options, frames)});
  rows.push_back({"Pleat, coarse", "coarse_frame", run_engine(scene, Mode::kCoarse, frames)});
  rows.push_back({"Pleat, coarse and tracked fine", "tracked_frame", run_engine(scene, Mode::kTrackedFine, frames)});

  std::printf(
      "%s: %ld and %ld vertices, %d frames of %g ms, %zu thread(s); lean: %d sub-steps, particles %.1f mm apart\n",
      scene_file.c_str(), static_cast<long>(simulation.coarse().vertex_count()), static_cast<long>(fine.vertex_count()),
      frames, 1e3 * scene.frame_time_s, options.threads, options.substeps, 1e3 * radius);
  std::printf("%-38s %10s %10s %12s %14s %12s\n", "", "median ms", "p95 ms", "lean / it", "intersections",
              "dirty frames");
  const double lean = pleat::median(rows[0].run.frame_ms);
  json figures;
  for (const Row& row : rows) {
    const double ms = pleat::median(row.run.frame_ms);
    std::printf("%-38s %10.2f %10.2f %12.2f %14zu %12zu\n", row.name, ms, pleat::quantile(row.run.frame_ms, 0.95),
                lean / ms, row.run.intersections, row.run.dirty_frames);
    figures[row.figure] = {{"median", ms}, {"runs", row.run.frame_ms.size()}, {"unit", "ms"}};
    figures[std::string(row.figure) + "_self_intersections"] = {
        {"median", row.run.intersections}, {"runs", row.run.frame_ms.size()}, {"unit", "pairs of faces, all frames"}};
  }
  for (std::size_t k = 2; k < rows.size(); ++k) {
    figures[std::string("lean_over_") + rows[k].figure] = {
        {"median", lean / pleat::median(rows[k].run.frame_ms)}, {"runs", rows[k].run.frame_ms.size()}, {"unit", "1"}};
  }
  write_json(json_file, std::move(figures));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("A lean XPBD of the fine sheet against Pleat's coarse and tracked simulation; medians of the frames.");
  std::string scene = "deploy/scenes/draping.json", json_file;
  pleat::bench::LeanOptions options;
  double radius_mm = 9;
  int frames = 50;
  app.add_option("scene", scene, "scene file")->capture_default_str();
  app.add_option("--frames", frames, "frames")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--substeps", options.substeps, "of the lean rival, a frame")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--detections", options.detections, "searches for close particles a frame; divides the sub-steps")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--radius-mm", radius_mm, "distance that particles keep")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--threads", options.threads, "1 or 2")->check(CLI::Range(1, 2))->capture_default_str();
  app.add_option("--json", json_file, "writes the figures to this file");
  Sizes sizes;
  app.add_option("--rounds", sizes.rounds, "whole jobs with so many rounds of subdivision each, instead")
      ->check(CLI::Range(1, 5));
  app.add_option("--bundles", sizes.bundles, "with --rounds: the bundle of each, or one for all; none: the default");
  app.add_option("--details", sizes.details, "with --rounds: network, fold, or both of them")
      ->check(CLI::IsMember({"network", "fold"}))
      ->default_str("network");
  app.add_option("--job-frames", sizes.job.frames, "with --rounds: frames of a job")->capture_default_str();
  app.add_option("--models", sizes.job.models, "with --rounds: folder of the bundles");
  app.add_option("--out", sizes.job.out, "with --rounds: folder for logs and jobs")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  options.radius_m = 1e-3 * radius_mm;
  if (sizes.details.empty()) sizes.details = {"network"};
  if (options.substeps % options.detections != 0) {
    std::fprintf(stderr, "bench_lean_rival: --detections must divide --substeps\n");
    return 2;
  }
  try {
    if (sizes.rounds.empty()) return measure(scene, options, frames, json_file);
    pleat::install_signal_handlers();
    return measure_sizes(scene, sizes, options, frames, json_file);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_lean_rival: %s\n", error.what());
    return 1;
  }
}
