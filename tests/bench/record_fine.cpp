// bench_record_fine: simulates a scene with a fine cloth that tracks the coarse one as the options say, or is free, and
// records both (and the upsampled coarse cloth as `enhanced`), for measuring wrinkles. Prints the medians of its times.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "common/base/statistics.hpp"
#include "common/store/result.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace {

using pleat::simulation::Mode;

void record(const pleat::simulation::Scene& scene, Mode mode, const std::filesystem::path& path) {
  pleat::simulation::Simulation simulation(scene, mode);
  pleat::ResultOptions options;
  options.topology = {simulation.coarse(), simulation.fine(), simulation.feature_vertices()};
  options.frames = static_cast<std::uint64_t>(scene.frames);
  options.frame_time_s = scene.frame_time_s;
  options.model = "upsampled";
  options.has_fine = true;
  options.obstacles = simulation.obstacle_shapes();
  for (const pleat::simulation::Obstacle& obstacle : scene.obstacles) {
    options.obstacle_vertices.push_back(obstacle.mesh.vertex_count());
  }
  pleat::ResultWriter writer(path, options);
  std::vector<double> fine_ms, assembly_ms, solve_ms, contact_ms;
  std::uint64_t cuts = 0, iterations = 0;
  for (int k = 0; k < scene.frames; ++k) {
    pleat::simulation::SimulatedFrame frame = simulation.next_frame();
    fine_ms.push_back(frame.times.fine_ms);
    assembly_ms.push_back(frame.times.assembly_ms);
    solve_ms.push_back(frame.times.solve_ms);
    contact_ms.push_back(frame.times.contact_ms);
    cuts += frame.report.cut_steps;
    iterations += frame.report.solver_iterations;
    pleat::ResultFrame row;
    row.time_s = frame.coarse.time_s;
    row.enhanced = pleat::upsample(simulation.subdivision(), simulation.coarse().faces, frame.coarse.positions);
    row.coarse = std::move(frame.coarse.positions);
    row.fine = std::move(frame.fine->positions);
    row.obstacles = std::move(frame.obstacles);
    writer.append(row);
  }
  writer.finish();
  using pleat::median;
  std::printf("%s: fine %.1f ms a frame (assembly %.1f, solve %.1f, contact %.1f), %.0f iterations, %llu steps cut\n",
              path.c_str(), median(fine_ms), median(assembly_ms), median(solve_ms), median(contact_ms),
              static_cast<double>(iterations) / scene.frames, static_cast<unsigned long long>(cuts));
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Records a scene's fine simulation, tracked or free.");
  std::string scene_file = "deploy/scenes/draping.json", mode = "tracked", out;
  int frames = 61, threads = 0, coarse_steps = 2;
  double frequency = -1, spring = -1;
  bool published = false;
  app.add_option("scene", scene_file, "scene file")->capture_default_str();
  app.add_option("--out", out, "the result to write")->required();
  app.add_option("--mode", mode, "tracked or free")->capture_default_str()->check(CLI::IsMember({"tracked", "free"}));
  app.add_option("--frequency", frequency, "of averages, rad/s; unset: the scene's");
  app.add_option("--spring", spring, "N/m at every feature vertex; unset: the scene's");
  app.add_flag("--published", published, "springs of 10 N/m and two levels");
  app.add_option("--coarse-steps", coarse_steps, "in a fine step")->capture_default_str();
  app.add_option("--frames", frames, "frames")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--threads", threads, "0: the processors this process may use")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    pleat::simulation::Scene scene =
        pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
    if (published) scene.tracking = pleat::simulation::published_tracking();
    if (frequency >= 0) scene.tracking.frequency = frequency;
    if (spring >= 0) scene.tracking.spring = spring;
    scene.tracking.coarse_steps = coarse_steps;
    scene.frames = frames;
    scene.threads = threads;
    std::filesystem::create_directories(std::filesystem::absolute(out).parent_path());
    record(scene, mode == "free" ? Mode::kFreeFine : Mode::kTrackedFine, out);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_record_fine: %s\n", error.what());
    return 1;
  }
}
