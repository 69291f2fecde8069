// Benchmarks of the algorithms, called directly.
#include <chrono>
#include <cmath>
#include <functional>

#include "common/mesh/subdivision.hpp"
#include "services/cli/bench.hpp"
#include "services/cli/median.hpp"
#include "services/cli/scene_file.hpp"
#include "services/conversion/image_map.hpp"
#include "services/refinement/judge.hpp"
#include "services/refinement/refiner.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::cli {
namespace {

using simulation::Mode;

constexpr std::size_t kConversionRuns = 100, kMapRuns = 3, kRoundTrips = 10;
constexpr double kTau = 6.283185307179586;

double milliseconds(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

simulation::Scene load_scene(const std::filesystem::path& file, std::size_t frames) {
  simulation::Scene scene = simulation::scene_from_message(read_scene_file(file));
  scene.frames = static_cast<int>(frames + 1);  // frame 0 is the initial state and costs nothing
  return scene;
}

Figure time_of_frames(const BenchOptions& options, Mode mode, std::size_t frames) {
  simulation::Simulation simulation(load_scene(scene_or(options, "draping"), frames), mode);
  simulation.next_frame();
  std::vector<double> ms;
  for (std::size_t k = 0; k < frames; ++k) ms.push_back(milliseconds([&] { simulation.next_frame(); }));
  return {median(ms), ms.size(), "ms"};
}

/// Waves along the normals, in two directions of the material: wrinkles of known size, the same on every machine.
void add_wrinkles(const Topology& fine, double amplitude_m, double wavelength_m, double phase, Positions& positions) {
  const Positions normals = vertex_normals(positions, fine.faces);
  const Positions& rest = fine.rest_positions;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    const double a = static_cast<double>(rest(v, 0)) + 0.4 * static_cast<double>(rest(v, 2));
    const double b =
        static_cast<double>(rest(v, 2)) - 0.7 * static_cast<double>(rest(v, 0)) + static_cast<double>(rest(v, 1));
    const double wave = std::sin(kTau * a / wavelength_m + phase) + 0.5 * std::sin(kTau * b / (0.6 * wavelength_m));
    positions.row(v) += static_cast<float>(amplitude_m * wave / 1.5) * normals.row(v);
  }
}

/// The coarse cloth bent over a cylinder-like fold, and the fine one on it with wrinkles.
struct WrinkledPair {
  Frame coarse, fine;
};
WrinkledPair wrinkled_pair(const Topology& coarse, const Subdivision& subdivision, double phase) {
  WrinkledPair pair;
  pair.coarse.positions = coarse.rest_positions;
  for (Eigen::Index v = 0; v < pair.coarse.positions.rows(); ++v) {
    const double x = static_cast<double>(coarse.rest_positions(v, 0));
    pair.coarse.positions(v, 1) += static_cast<float>(0.1 * std::sin(kTau * x / 0.8 + phase));
  }
  pair.coarse.velocities = Positions::Constant(pair.coarse.positions.rows(), 3, 0.25f);
  pair.fine.positions = upsample(subdivision, coarse.faces, pair.coarse.positions);
  add_wrinkles(subdivision.fine, 0.005, 0.05, phase, pair.fine.positions);
  pair.fine.velocities = Positions::Constant(pair.fine.positions.rows(), 3, 0.25f);
  return pair;
}

}  // namespace

std::filesystem::path scene_or(const BenchOptions& options, const std::string& name) {
  return options.scene.empty() ? std::filesystem::path("deploy/scenes") / (name + ".json") : options.scene;
}

Figures bench_simulation(const BenchOptions& options) {
  const std::size_t costly = std::max<std::size_t>(1, options.frames / 4);
  return {{"coarse_frame", time_of_frames(options, Mode::kCoarse, options.frames)},
          {"tracked_frame", time_of_frames(options, Mode::kTrackedFine, costly)},
          {"fine_frame", time_of_frames(options, Mode::kFreeFine, costly)}};
}

Figures bench_conversion(const BenchOptions& options) {
  const simulation::Scene scene = load_scene(scene_or(options, "draping"), 1);
  const Topology& coarse = scene.garment;
  const Subdivision subdivision = subdivide(coarse, scene.subdivision_rounds);
  std::vector<double> build, image_ms, mesh_ms, rms, largest;
  for (std::size_t r = 0; r < kMapRuns; ++r)
    build.push_back(milliseconds([&] { const ImageMap map(coarse, subdivision.fine); }));
  const ImageMap map(coarse, subdivision.fine);
  const WrinkledPair pair = wrinkled_pair(coarse, subdivision, 0.3);
  const RigidTransform alignment = map.align(pair.coarse.positions);
  Tensor coarse_image;
  for (std::size_t r = 0; r < kConversionRuns; ++r)
    image_ms.push_back(
        milliseconds([&] { map.coarse_image(pair.coarse, map.align(pair.coarse.positions), coarse_image); }));
  const Tensor fine_image = map.fine_image(pair.fine, alignment);
  Positions positions;
  for (std::size_t r = 0; r < kConversionRuns; ++r)
    mesh_ms.push_back(milliseconds([&] { map.to_mesh(fine_image, alignment, positions); }));
  for (std::size_t r = 0; r < kRoundTrips; ++r) {
    const WrinkledPair trip = wrinkled_pair(coarse, subdivision, 0.7 * static_cast<double>(r));
    const RigidTransform aligned = map.align(trip.coarse.positions);
    const Positions back = map.to_mesh(map.fine_image(trip.fine, aligned), aligned);
    const auto error = (back - trip.fine.positions).cast<double>().rowwise().squaredNorm().eval();
    rms.push_back(std::sqrt(error.mean()));
    largest.push_back(std::sqrt(error.maxCoeff()));
  }
  return {{"to_image", {median(image_ms), image_ms.size(), "ms"}},
          {"to_mesh", {median(mesh_ms), mesh_ms.size(), "ms"}},
          {"build_map", {median(build), build.size(), "ms"}},
          {"round_trip_rms", {median(rms), rms.size(), "m"}},
          {"round_trip_max", {median(largest), largest.size(), "m"}}};
}

Figures bench_refinement(const BenchOptions& options) {
  simulation::Simulation simulation(load_scene(scene_or(options, "hitting"), options.frames), Mode::kCoarse);
  const Topology& coarse = simulation.coarse();
  const Subdivision subdivision = subdivide(coarse, simulation.scene().subdivision_rounds);
  const std::vector<ObstacleShape> shapes = simulation.obstacle_shapes();
  Refiner refiner(coarse, subdivision, shapes);
  std::vector<double> ms;
  double before_pairs = 0, before_faces = 0, pairs = 0, faces = 0;
  for (std::size_t k = 0; k <= options.frames; ++k) {
    const simulation::SimulatedFrame frame = simulation.next_frame();
    Positions fine = upsample(subdivision, coarse.faces, frame.coarse.positions);
    add_wrinkles(subdivision.fine, 0.004, 0.04, 0.2 * static_cast<double>(k), fine);
    RefinedMesh refined;
    ms.push_back(milliseconds([&] { refined = refiner.refine(frame.coarse.positions, fine, frame.obstacles); }));
    before_pairs += static_cast<double>(refined.report.pairs_before);
    before_faces += static_cast<double>(refined.report.penetrations_before);
    pairs += static_cast<double>(count_self_intersections(refined.positions, subdivision.fine.faces));
    faces +=
        static_cast<double>(count_penetrations(refined.positions, subdivision.fine.faces, shapes, frame.obstacles));
  }
  return {{"refine", {median(ms), ms.size(), "ms"}},
          {"refine_p95", {quantile(ms, 0.95), ms.size(), "ms"}},
          {"penetrations", {faces, ms.size(), "faces in all frames"}},
          {"self_intersections", {pairs, ms.size(), "pairs of faces in all frames"}},
          {"penetrations_before", {before_faces, ms.size(), "faces in all frames"}},
          {"self_intersections_before", {before_pairs, ms.size(), "pairs of faces in all frames"}}};
}

}  // namespace pleat::cli
