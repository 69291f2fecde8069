// bench_simulation_profile: where the time of a simulated frame goes, per mode. A measurement, not a test.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>
#include <vector>

#include "common/base/statistics.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace {

using pleat::simulation::Mode;

void measure(pleat::simulation::Scene scene, const char* name, Mode mode, int first, int frames) {
  scene.frames = first + frames + 1;
  pleat::simulation::Simulation simulation(std::move(scene), mode);
  for (int k = 0; k <= first; ++k) simulation.next_frame();
  std::vector<double> coarse, fine, assembly, solve, contact;
  std::uint64_t iterations = 0, contacts = 0, impacts = 0, cuts = 0;
  for (int k = 0; k < frames; ++k) {
    const pleat::simulation::SimulatedFrame frame = simulation.next_frame();
    coarse.push_back(frame.times.coarse_ms);
    fine.push_back(frame.times.fine_ms);
    assembly.push_back(frame.times.assembly_ms);
    solve.push_back(frame.times.solve_ms);
    contact.push_back(frame.times.contact_ms);
    iterations += frame.report.solver_iterations;
    contacts += frame.report.contacts;
    impacts += frame.report.impacts;
    cuts += frame.report.cut_steps;
  }
  const auto n = static_cast<double>(frames);
  using pleat::median;
  std::printf("%-8s %9.2f %9.2f %9.2f %9.2f %9.2f %9.1f %9.0f %9.1f %5llu\n", name, median(coarse), median(fine),
              median(assembly), median(solve), median(contact), static_cast<double>(iterations) / n,
              static_cast<double>(contacts) / n, static_cast<double>(impacts) / n,
              static_cast<unsigned long long>(cuts));
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Median milliseconds of a frame and of its parts (those of the finest mesh), and counts per frame.");
  std::string scene_file = "deploy/scenes/draping.json", mode = "all";
  int frames = 40, first = 0, threads = 0, steps = 0;
  app.add_option("scene", scene_file, "scene file")->capture_default_str();
  app.add_option("--mode", mode, "coarse, tracked, free or all")->capture_default_str();
  app.add_option("--first", first, "frames simulated before the measured ones")->capture_default_str();
  app.add_option("--frames", frames, "frames measured")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--steps", steps, "steps a frame; 0: the scene's")->capture_default_str();
  app.add_option("--threads", threads, "0: the processors this process may use")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    pleat::simulation::Scene scene =
        pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
    scene.threads = threads;
    if (steps > 0) scene.steps_per_frame = steps;
    std::printf("%-8s %9s %9s %9s %9s %9s %9s %9s %9s %5s\n", "mode", "coarse", "fine", "assembly", "solve", "contact",
                "CG its", "contacts", "impacts", "cuts");
    if (mode == "all" || mode == "coarse") measure(scene, "coarse", Mode::kCoarse, first, frames);
    if (mode == "all" || mode == "tracked") measure(scene, "tracked", Mode::kTrackedFine, first, frames);
    if (mode == "all" || mode == "free") measure(scene, "free", Mode::kFreeFine, first, frames);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_simulation_profile: %s\n", error.what());
    return 1;
  }
}
