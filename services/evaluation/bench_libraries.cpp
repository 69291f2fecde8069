// Benchmarks of the algorithms, called directly.
#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <numeric>
#include <optional>
#include <span>

#include "common/base/process.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/obj.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "services/conversion/representation.hpp"
#include "services/evaluation/bench_inputs.hpp"
#include "services/evaluation/evaluation.hpp"
#include "services/evaluation/metrics.hpp"
#include "services/refinement/judge.hpp"
#include "services/refinement/refiner.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::evaluation {
namespace {

using simulation::Mode;

constexpr std::size_t kConversionRuns = 100, kMapRuns = 3;

double milliseconds(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

Figure time_of_frames(const simulation::Scene& scene, Mode mode, std::size_t frames) {
  simulation::Simulation simulation(scene, mode);
  simulation.next_frame();
  std::vector<double> ms;
  for (std::size_t k = 0; k < frames; ++k) ms.push_back(milliseconds([&] { simulation.next_frame(); }));
  return {median(ms), ms.size(), "ms"};
}

Figure time_of_frames(const BenchOptions& options, Mode mode, std::size_t frames) {
  return time_of_frames(load_bench_scene(scene_or(options, "draping"), frames), mode, frames);
}

/// Round trips fine mesh -> image -> mesh over frames.
class RoundTrips {
 public:
  void add(const conversion::ImageMap& map, const FramePair& pair) {
    const RigidTransform alignment = map.align(pair.coarse.positions);
    map.fine_image(pair.fine, alignment, image_);
    map.to_mesh(image_, alignment, back_);
    const Eigen::VectorXd squares = (back_ - pair.fine.positions).cast<double>().rowwise().squaredNorm();
    sum_ += squares.mean();
    largest_ = std::max(largest_, squares.maxCoeff());
    ++frames_;
  }
  Figure rms() const { return {std::sqrt(sum_ / static_cast<double>(frames_)), frames_, "m"}; }
  Figure largest() const { return {std::sqrt(largest_), frames_, "m"}; }

 private:
  double sum_ = 0, largest_ = 0;
  std::size_t frames_ = 0;
  Tensor image_;
  Positions back_;
};

/// A garment, and frames of it by their number.
struct Frames {
  const Topology& coarse;
  const Topology& fine;
  std::function<FramePair(std::size_t)> at;
  std::size_t count = 0;
};

RoundTrips round_trips(const Frames& frames, std::size_t count, const conversion::ImageSpec& spec) {
  const conversion::ImageMap map(frames.coarse, frames.fine, spec);
  RoundTrips trips;
  count = std::min(count, frames.count);
  for (std::size_t i = 0; i < count; ++i) trips.add(map, frames.at(i * frames.count / count));
  return trips;
}

/// The errors against texels per vertex, for both methods, and of the published size. `prefix` goes before the names.
void add_round_trip_table(const Frames& frames, const std::string& prefix, Figures& figures) {
  const auto add = [&](const std::string& size, const conversion::ImageSpec& base, std::size_t count) {
    for (const auto& [name, method] : {std::pair{"fitted", conversion::FineImageMethod::kFitted},
                                       std::pair{"sampled", conversion::FineImageMethod::kSampled}}) {
      conversion::ImageSpec spec = base;
      spec.method = method;
      const RoundTrips trips = round_trips(frames, count, spec);
      figures.emplace_back(prefix + "round_trip_rms/" + name + "/" + size, trips.rms());
      figures.emplace_back(prefix + "round_trip_max/" + name + "/" + size, trips.largest());
    }
  };
  for (const char* texels : {"1.4", "2", "3", "6"}) {
    conversion::ImageSpec spec;
    spec.texels_per_fine_vertex = std::stod(texels);
    add(texels, spec, frames.count);
  }
  conversion::ImageSpec published;
  published.coarse_width = 192;
  published.coarse_height = 128;
  add("768x512", published, std::max<std::size_t>(1, frames.count / 10));
}

}  // namespace

std::filesystem::path scene_or(const BenchOptions& options, const std::string& name) {
  return options.scene.empty() ? shipped_file(std::filesystem::path("scenes") / (name + ".json")) : options.scene;
}

Figure coarse_frame_time(const BenchOptions& options) { return time_of_frames(options, Mode::kCoarse, options.frames); }

Figure tracked_frame_time(const BenchOptions& options) {
  return time_of_frames(options, Mode::kTrackedFine, options.frames);
}

Figure frame_time(const std::string& scene, Mode mode, std::size_t frames) {
  return time_of_frames(parse_bench_scene(scene, frames), mode, frames);
}

Figures bench_simulation(const BenchOptions& options) {
  const std::size_t costly = std::max<std::size_t>(1, options.frames / 4);
  return {{"coarse_frame", time_of_frames(options, Mode::kCoarse, options.frames)},
          {"tracked_frame", time_of_frames(options, Mode::kTrackedFine, costly)},
          {"fine_frame", time_of_frames(options, Mode::kFreeFine, costly)}};
}

namespace {

/// The detail layout at 16, 64 and 256 faces per coarse face. Its coarse image stays, so that the fine one grows with
/// the mesh.
void add_detail_times(const Topology& coarse, Figures& figures) {
  struct Size {
    std::unique_ptr<const conversion::Representation> representation;
    Tensor input, answer;
    std::vector<double> build, encode, decode;
  };
  std::vector<Size> sizes;
  conversion::RepresentationSpec spec;
  for (const int rounds : {2, 3, 4}) {
    conversion::GeometryImageSpec image;
    image.layout = conversion::ImageLayout::kDetail;
    image.image.scale = 1 << rounds;
    if (!sizes.empty()) {
      const auto shape = sizes.front().representation->input_shape();
      image.image.coarse_height = static_cast<int>(shape[1]), image.image.coarse_width = static_cast<int>(shape[2]);
    }
    spec.kind = image;
    spec.subdivision.rounds = rounds;
    Size& size = sizes.emplace_back();
    size.build.push_back(milliseconds([&] { size.representation = conversion::make_representation(coarse, spec); }));
    size.answer.shape = size.representation->answer_shape();
    size.answer.values.assign(3 * size.representation->answer_mask().size(), 1e-3F);
  }
  const Frame frame = wrinkled_pair(coarse, sizes.front().representation->subdivision(), 0.3).coarse;
  Positions fine;
  for (std::size_t r = 0; r < kConversionRuns; ++r) {
    for (Size& size : sizes) {
      const RigidTransform alignment = size.representation->align(frame.positions);
      size.encode.push_back(
          milliseconds([&] { size.representation->encode(std::span(&frame, 1), alignment, size.input, nullptr); }));
      size.decode.push_back(
          milliseconds([&] { size.representation->decode(size.answer, frame.positions, alignment, fine); }));
    }
  }
  for (const Size& size : sizes) {
    const std::string name = "detail/" + std::to_string(size.representation->fine().vertex_count()) + "/";
    figures.push_back({name + "build", {median(size.build), size.build.size(), "ms"}});
    figures.push_back({name + "encode", {median(size.encode), size.encode.size(), "ms"}});
    figures.push_back({name + "decode", {median(size.decode), size.decode.size(), "ms"}});
  }
}

}  // namespace

Figures bench_conversion(const BenchOptions& options) {
  const simulation::Scene scene = load_bench_scene(scene_or(options, "draping"), 1);
  std::optional<DatasetReader> dataset;
  if (!options.dataset.empty()) dataset.emplace(options.dataset);
  const Topology& coarse = dataset ? dataset->topology().coarse : scene.garment;
  const Subdivision subdivision =
      subdivide(coarse, dataset ? subdivision_of(dataset->topology())
                                : SubdivisionSpec{scene.subdivision_rounds, scene.subdivision_rule});
  std::vector<double> build, image_ms, mesh_ms;
  for (std::size_t r = 0; r < kMapRuns; ++r)
    build.push_back(milliseconds([&] { const conversion::ImageMap map(coarse, subdivision.fine); }));
  const conversion::ImageMap map(coarse, subdivision.fine);
  const FramePair pair = wrinkled_pair(coarse, subdivision, 0.3);
  const RigidTransform alignment = map.align(pair.coarse.positions);
  Tensor coarse_image;
  for (std::size_t r = 0; r < kConversionRuns; ++r)
    image_ms.push_back(
        milliseconds([&] { map.coarse_image(pair.coarse, map.align(pair.coarse.positions), coarse_image); }));
  const Tensor fine_image = map.fine_image(pair.fine, alignment);
  Positions positions;
  for (std::size_t r = 0; r < kConversionRuns; ++r)
    mesh_ms.push_back(milliseconds([&] { map.to_mesh(fine_image, alignment, positions); }));

  Frames frames{coarse, subdivision.fine, {}, options.frames};
  frames.at = [&](std::size_t i) { return wrinkled_pair(coarse, subdivision, 0.7 * static_cast<double>(i)); };
  std::vector<FramePair> of_dataset;
  if (dataset) {
    for (const FramePlace& place : choose_frames(*dataset, options.frames))
      of_dataset.push_back(read_pair(*dataset, place));
    frames.count = of_dataset.size();
    frames.at = [&](std::size_t i) { return of_dataset[i]; };
  }
  const RoundTrips trips = round_trips(frames, frames.count, {});
  Figures figures{{"to_image", {median(image_ms), image_ms.size(), "ms"}},
                  {"to_mesh", {median(mesh_ms), mesh_ms.size(), "ms"}},
                  {"build_map", {median(build), build.size(), "ms"}},
                  {"round_trip_rms", trips.rms()},
                  {"round_trip_max", trips.largest()}};
  add_detail_times(coarse, figures);
  add_round_trip_table(frames, "", figures);

  const Topology skirt = read_obj(shipped_file("garments/skirt.obj"));
  const Subdivision fine_skirt = subdivide(skirt, 2);
  const auto at = [&](std::size_t i) { return wrinkled_pair(skirt, fine_skirt, 0.7 * static_cast<double>(i)); };
  add_round_trip_table({skirt, fine_skirt.fine, at, options.frames}, "skirt/", figures);
  return figures;
}

Figures bench_refinement(const BenchOptions& options) {
  const RefinementSetting* setting = nullptr;
  std::optional<refinement::Refiner> refiner;
  std::optional<DisplacementImageError> image_error;
  std::vector<double> ms, moves, largest;
  double before_pairs = 0, before_faces = 0, pairs = 0, faces = 0, unclean_inputs = 0, error_before = 0, error = 0;
  refinement::RefinedMesh refined;
  const auto begin = [&](const RefinementSetting& s) {
    if (setting == nullptr && s.range) image_error.emplace(s.coarse, s.subdivision.fine, *s.range);
    setting = &s;
    refiner.emplace(s.coarse, s.subdivision, s.shapes);
  };
  visit_refinement_inputs(options, begin, [&](const RefinementInput& input) {
    ms.push_back(milliseconds([&] { refiner->refine(input.coarse, input.fine, input.obstacles, refined); }));
    moves.push_back(refined.report.mean_move_m);
    largest.push_back(refined.report.largest_move_m);
    before_pairs += static_cast<double>(refined.report.pairs_before);
    before_faces += static_cast<double>(refined.report.penetrations_before);
    unclean_inputs += refined.report.input_intersects ? 1 : 0;
    const Faces& fine_faces = setting->subdivision.fine.faces;
    pairs += static_cast<double>(refinement::count_self_intersections(refined.positions, fine_faces));
    faces += static_cast<double>(
        refinement::count_penetrations(refined.positions, fine_faces, setting->shapes, input.obstacles));
    if (!image_error || !input.reference) return;
    error_before += image_error->mean_square_error(input.coarse, *input.reference, input.fine);
    error += image_error->mean_square_error(input.coarse, *input.reference, refined.positions);
  });
  const std::size_t runs = ms.size();
  const auto mean = [&](double sum) { return sum / static_cast<double>(runs); };
  Figures figures{{"refine", {median(ms), runs, "ms"}},
                  {"refine_p95", {quantile(ms, 0.95), runs, "ms"}},
                  {"penetrations", {faces, runs, "faces in all frames"}},
                  {"self_intersections", {pairs, runs, "pairs of faces in all frames"}},
                  {"penetrations_before", {before_faces, runs, "faces in all frames"}},
                  {"self_intersections_before", {before_pairs, runs, "pairs of faces in all frames"}},
                  {"inputs_that_intersect", {unclean_inputs, runs, "coarse frames"}},
                  {"mean_move", {mean(std::accumulate(moves.begin(), moves.end(), 0.0)), runs, "m"}},
                  {"largest_move", {*std::max_element(largest.begin(), largest.end()), runs, "m"}}};
  if (error > 0 && error_before > 0) {
    figures.push_back({"psnr_before", {psnr_db(mean(error_before)), runs, "dB"}});
    figures.push_back({"psnr", {psnr_db(mean(error)), runs, "dB"}});
  }
  return figures;
}

}  // namespace pleat::evaluation
