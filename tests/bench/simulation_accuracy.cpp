// bench_simulation_accuracy: error against milliseconds. Simulates the coarse cloth of a scene at several numbers of
// steps a frame and compares each run with one of many steps, the converged run. A measurement, not a test.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace {

using pleat::Positions;
using pleat::simulation::Scene;

struct Run {
  std::vector<Positions> frames;  // frame 0 is the initial state
  std::vector<double> frame_ms;   // of frames 1, 2, ...: whole frames, contact and obstacles included
  std::uint64_t cut_steps = 0, impacts = 0;
};

Run simulate(Scene scene, int steps_per_frame, int frames) {
  scene.steps_per_frame = steps_per_frame;
  scene.frames = frames + 1;
  pleat::simulation::Simulation simulation(std::move(scene), pleat::simulation::Mode::kCoarse);
  Run run;
  run.frames.push_back(simulation.next_frame().coarse.positions);
  for (int k = 0; k < frames; ++k) {
    const auto start = std::chrono::steady_clock::now();
    pleat::simulation::SimulatedFrame frame = simulation.next_frame();
    run.frame_ms.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
    run.frames.push_back(std::move(frame.coarse.positions));
    run.cut_steps += frame.report.cut_steps;
    run.impacts += frame.report.impacts;
  }
  return run;
}

// Root of the mean squared distance of a vertex from its twin, mm.
double rms_mm(const Positions& a, const Positions& b) {
  const Eigen::MatrixXd difference = a.cast<double>() - b.cast<double>();
  return 1e3 * std::sqrt(difference.rowwise().squaredNorm().mean());
}

// Mean over the edges of length over rest length.
double mean_stretch(const Positions& x, const Positions& rest, const std::vector<pleat::Edge>& edges) {
  double sum = 0;
  for (const pleat::Edge& e : edges) {
    sum += static_cast<double>((x.row(e.v0) - x.row(e.v1)).norm() / (rest.row(e.v0) - rest.row(e.v1)).norm());
  }
  return sum / static_cast<double>(edges.size());
}

int measure(const std::string& file, const std::vector<int>& steps, int converged_steps, int frames, int runs,
            int threads) {
  Scene scene = pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(file));
  scene.threads = threads;
  pleat::Topology garment = scene.garment;
  garment.rest_positions *= static_cast<float>(scene.transform.scale);
  const auto edges = pleat::build_connectivity(garment.vertex_count(), garment.faces).edges;

  const Run converged = simulate(scene, converged_steps, frames);
  std::printf("%s: %ld vertices, %d frames of %g ms, %d run(s) each; converged: %d steps a frame, %.2f ms, %llu cut\n",
              file.c_str(), static_cast<long>(garment.vertex_count()), frames, 1e3 * scene.frame_time_s, runs,
              converged_steps, pleat::median(converged.frame_ms), static_cast<unsigned long long>(converged.cut_steps));
  // Two looks at the error: half way and at the end (frames 20 and 40 by default).
  const int looks[] = {frames / 2, frames};
  std::printf("%6s %10s %10s %13s %13s %15s %15s %8s %8s\n", "steps", "median ms", "p95 ms",
              ("RMS mm @" + std::to_string(looks[0])).c_str(), ("RMS mm @" + std::to_string(looks[1])).c_str(),
              ("stretch % @" + std::to_string(looks[0])).c_str(), ("stretch % @" + std::to_string(looks[1])).c_str(),
              "impacts", "cut");
  for (const int n : steps) {
    Run run;
    std::vector<double> ms;
    for (int r = 0; r < runs; ++r) {
      run = simulate(scene, n, frames);
      ms.insert(ms.end(), run.frame_ms.begin(), run.frame_ms.end());
    }
    double rms[2], stretch[2];
    for (int k = 0; k < 2; ++k) {
      const Positions& mine = run.frames[static_cast<std::size_t>(looks[k])];
      const Positions& truth = converged.frames[static_cast<std::size_t>(looks[k])];
      rms[k] = rms_mm(mine, truth);
      const double expected = mean_stretch(truth, garment.rest_positions, edges);
      stretch[k] = 100 * (mean_stretch(mine, garment.rest_positions, edges) - expected) / expected;
    }
    std::printf("%6d %10.2f %10.2f %13.2f %13.2f %15.3f %15.3f %8llu %8llu\n", n, pleat::median(ms),
                pleat::quantile(ms, 0.95), rms[0], rms[1], stretch[0], stretch[1],
                static_cast<unsigned long long>(run.impacts), static_cast<unsigned long long>(run.cut_steps));
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Error of the coarse simulation against its converged run, and milliseconds a frame.");
  std::string scene = "deploy/scenes/draping.json";
  std::vector<int> steps{1, 2, 4, 8, 16, 32};
  int converged = 128, frames = 40, runs = 1, threads = 0;
  app.add_option("scene", scene, "scene file")->capture_default_str();
  app.add_option("--steps", steps, "steps a frame, a list")->delimiter(',')->check(CLI::PositiveNumber);
  app.add_option("--converged", converged, "steps a frame of the converged run")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--frames", frames, "frames; errors are taken half way and at the end")
      ->check(CLI::Range(2, 100000))
      ->capture_default_str();
  app.add_option("--runs", runs, "runs of each; times are pooled")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--threads", threads, "0: the processors this process may use")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    return measure(scene, steps, converged, frames, runs, threads);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_simulation_accuracy: %s\n", error.what());
    return 1;
  }
}
