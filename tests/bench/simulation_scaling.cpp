// bench_simulation_scaling: milliseconds of a frame as the mesh grows, each mesh simulated as a coarse garment of its
// own. A measurement, not a test.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/machine.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace {

using nlohmann::json;
using pleat::median;
using pleat::simulation::Scene;

struct Cost {
  double vertices = 0, total_ms = 0, assembly_ms = 0, solve_ms = 0, contact_ms = 0, iterations = 0;
};

// Medians of the frames [first, first + frames); iterations of the linear solver a step.
Cost simulate(Scene scene, int first, int frames) {
  const int steps = scene.steps_per_frame;
  scene.frames = first + frames + 1;
  // The fine mesh that a scene may ask for isn't simulated.
  scene.subdivision_rounds = 0;
  pleat::simulation::Simulation simulation(std::move(scene), pleat::simulation::Mode::kCoarse);
  for (int k = 0; k <= first; ++k) simulation.next_frame();
  std::vector<double> total, assembly, solve, contact, iterations;
  for (int k = 0; k < frames; ++k) {
    const pleat::simulation::SimulatedFrame frame = simulation.next_frame();
    total.push_back(frame.times.coarse_ms);
    assembly.push_back(frame.times.assembly_ms);
    solve.push_back(frame.times.solve_ms);
    contact.push_back(frame.times.contact_ms);
    iterations.push_back(static_cast<double>(frame.report.solver_iterations) / steps);
  }
  return {static_cast<double>(simulation.coarse().vertex_count()),
          median(total),
          median(assembly),
          median(solve),
          median(contact),
          median(iterations)};
}

// Slope of log ms over log vertices, least squares.
double exponent(const std::vector<Cost>& costs) {
  double x = 0, y = 0, xx = 0, xy = 0;
  for (const Cost& cost : costs) {
    const double u = std::log(cost.vertices), v = std::log(cost.total_ms);
    x += u;
    y += v;
    xx += u * u;
    xy += u * v;
  }
  const auto n = static_cast<double>(costs.size());
  return (n * xy - x * y) / (n * xx - x * x);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Median milliseconds of a frame as the mesh grows: the scene's garment, subdivided 0, 1, ... times and "
      "simulated\n"
      "as a coarse garment each. In brackets the exponent between a mesh and the one before.");
  std::string scene_file = "deploy/scenes/draping.json", json_file;
  int rounds = 3, first = 10, frames = 10, threads = 0;
  app.add_option("scene", scene_file, "scene file")->capture_default_str();
  app.add_option("--rounds", rounds, "subdivisions of the largest mesh")
      ->check(CLI::Range(1, 5))
      ->capture_default_str();
  app.add_option("--first", first, "frames simulated before the measured ones")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  app.add_option("--frames", frames, "frames measured")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--threads", threads, "0: the processors this process may use")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  app.add_option("--json", json_file, "writes the figures to this file");
  CLI11_PARSE(app, argc, argv);
  try {
    Scene scene = pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
    scene.threads = threads;
    const pleat::Topology garment = scene.garment;
    std::printf("%9s %18s %10s %10s %10s %14s\n", "vertices", "frame ms", "assembly", "solve", "contact", "its a step");
    std::vector<Cost> costs;
    json rows = json::array();
    for (int round = 0; round <= rounds; ++round) {
      scene.garment = pleat::subdivide(garment, round).fine;
      costs.push_back(simulate(scene, first, frames));
      const Cost& cost = costs.back();
      const std::string growth =
          round == 0 ? "" : " (" + std::to_string(exponent({costs[costs.size() - 2], cost})).substr(0, 4) + ")";
      std::printf("%9.0f %11.2f%7s %10.2f %10.2f %10.2f %14.1f\n", cost.vertices, cost.total_ms, growth.c_str(),
                  cost.assembly_ms, cost.solve_ms, cost.contact_ms, cost.iterations);
      std::fflush(stdout);
      rows.push_back({{"vertices", cost.vertices},
                      {"frame_ms", cost.total_ms},
                      {"assembly_ms", cost.assembly_ms},
                      {"solve_ms", cost.solve_ms},
                      {"contact_ms", cost.contact_ms},
                      {"iterations", cost.iterations}});
    }
    std::printf("milliseconds grow as vertices^%.2f\n", exponent(costs));
    if (!json_file.empty()) {
      std::ofstream(json_file) << json{{"rows", rows},
                                       {"exponent", exponent(costs)},
                                       {"machine", pleat::machine_info()},
                                       {"git_revision", pleat::git_revision()}}
                                      .dump(2)
                               << "\n";
    }
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_simulation_scaling: %s\n", error.what());
    return 1;
  }
}
