// bench_fold_step: folds the coarse frames of a result or of a scene's coarse simulation, refines what comes out, and
// records it as `enhanced` for measuring wrinkles. Prints medians of both and what refinement met.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "common/base/statistics.hpp"
#include "common/store/result.hpp"
#include "services/fold/fold_step.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/refinement/refiner.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace {

// The coarse vertices of the handles that are active at a time.
std::vector<std::uint32_t> held_at(const pleat::simulation::Scene& scene, double time_s) {
  std::vector<std::uint32_t> held;
  for (const pleat::simulation::Handle& handle : scene.handles) {
    if (time_s < handle.start_s || time_s >= handle.end_s) continue;
    held.insert(held.end(), handle.vertices.begin(), handle.vertices.end());
  }
  return held;
}

void run(const pleat::simulation::Scene& scene, const pleat::fold::FoldOptions& options, int threads,
         const std::filesystem::path& path) {
  pleat::simulation::Simulation simulation(scene, pleat::simulation::Mode::kCoarse);
  const pleat::Subdivision subdivision = pleat::subdivide(simulation.coarse(), scene.subdivision_rounds);
  const auto shapes = simulation.obstacle_shapes();
  pleat::fold::FoldStep step(simulation.coarse(), subdivision, shapes, options);
  pleat::refinement::RefinementOptions refinement;
  refinement.threads = threads;
  pleat::refinement::Refiner refiner(simulation.coarse(), subdivision, shapes, refinement);
  pleat::ResultOptions result;
  result.topology = {simulation.coarse(), subdivision.fine, subdivision.feature_vertices};
  result.frames = static_cast<std::uint64_t>(scene.frames);
  result.frame_time_s = scene.frame_time_s;
  result.model = "fold";
  result.obstacles = shapes;
  for (const auto& obstacle : scene.obstacles) result.obstacle_vertices.push_back(obstacle.mesh.vertex_count());
  pleat::ResultWriter writer(path, result);
  pleat::fold::FoldState state;
  std::vector<double> fold_ms, contact_ms, refine_ms, zones, pairs, reach_in, searches, layers;
  int unclean = 0, restarts = 0;
  for (int k = 0; k < scene.frames; ++k) {
    const pleat::simulation::SimulatedFrame frame = simulation.next_frame();
    const std::vector<std::uint32_t> held = held_at(scene, frame.coarse.time_s);
    const pleat::fold::FoldReport report =
        step.fold({frame.coarse.positions, frame.coarse.velocities, frame.obstacles, held}, state);
    const pleat::refinement::RefinedMesh refined =
        refiner.refine(frame.coarse.positions, state.positions, frame.obstacles);
    fold_ms.push_back(report.ms);
    contact_ms.push_back(report.contact_ms);
    layers.push_back(static_cast<double>(report.layer_contacts));
    refine_ms.push_back(refined.report.ms);
    zones.push_back(static_cast<double>(refined.report.zones));
    pairs.push_back(static_cast<double>(refined.report.pairs_before));
    reach_in.push_back(static_cast<double>(refined.report.penetrations_before));
    searches.push_back(static_cast<double>(refined.report.rounds));
    unclean += refined.report.clean() ? 0 : 1;
    restarts += report.restarted ? 1 : 0;
    pleat::ResultFrame row;
    row.time_s = frame.coarse.time_s;
    row.coarse = frame.coarse.positions;
    row.enhanced = refined.positions;
    row.obstacles = frame.obstacles;
    writer.append(row);
  }
  writer.finish();
  using pleat::median;
  std::printf("%s: fold %.1f ms, p95 %.1f (finding contacts %.1f, p95 %.1f; layers %.0f, p95 %.0f), %d begun\n",
              path.c_str(), median(fold_ms), pleat::quantile(fold_ms, 0.95), median(contact_ms),
              pleat::quantile(contact_ms, 0.95), median(layers), pleat::quantile(layers, 0.95), restarts);
  std::printf("refinement %.1f ms, p95 %.1f; zones %.0f, p95 %.0f; searches %.0f, p95 %.0f; %d frames not clean\n",
              median(refine_ms), pleat::quantile(refine_ms, 0.95), median(zones), pleat::quantile(zones, 0.95),
              median(searches), pleat::quantile(searches, 0.95), unclean);
  std::printf("it met intersecting pairs %.0f, p95 %.0f; faces in obstacles %.0f, p95 %.0f\n", median(pairs),
              pleat::quantile(pairs, 0.95), median(reach_in), pleat::quantile(reach_in, 0.95));
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Folds and refines the coarse frames of a scene.");
  std::string scene_file = "deploy/scenes/draping.json", material_file, out;
  pleat::fold::FoldOptions options;
  int frames = 61, threads = 0;
  double step_ms = 1e3 * options.step_s;
  app.add_option("scene", scene_file, "scene file")->capture_default_str();
  app.add_option("--out", out, "the result to write")->required();
  app.add_option("--material", material_file, "of the coarse and the fine cloth, instead of the scene's");
  app.add_option("--frames", frames, "frames")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--frequency", options.frequency, "of averages, rad/s")->capture_default_str();
  app.add_option("--step-ms", step_ms, "of the cloth, at most")->capture_default_str();
  app.add_option("--threads", threads, "of simulation and refinement")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    pleat::simulation::Scene scene =
        pleat::simulation::scene_from_message(pleat::presentation::read_scene_file(scene_file));
    if (!material_file.empty()) scene.material = pleat::simulation::read_material(material_file);
    scene.frames = frames;
    scene.threads = threads;
    options.step_s = 1e-3 * step_ms;
    options.material = scene.material;
    options.frame_time_s = scene.frame_time_s;
    options.gravity = scene.gravity;
    options.air_density = scene.wind.density;
    options.air_velocity = scene.wind.velocity;
    std::filesystem::create_directories(std::filesystem::absolute(out).parent_path());
    run(scene, options, threads, out);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_fold_step: %s\n", error.what());
    return 1;
  }
}
