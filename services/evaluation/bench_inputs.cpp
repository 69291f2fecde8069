#include "services/evaluation/bench_inputs.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"
#include "common/features/frame_features.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "services/conversion/session.hpp"
#include "services/evaluation/evaluation.hpp"
#include "services/evaluation/superres_process.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::evaluation {
namespace {

simulation::Scene cut(const v1::Scene& message, std::size_t frames) {
  simulation::Scene scene = simulation::scene_from_message(message);
  scene.frames = static_cast<int>(frames + 1);  // frame 0 is the initial state and costs nothing
  return scene;
}

constexpr double kTau = 6.283185307179586;

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

/// A bundle and the conversions around it, called one after the other.
class Enhancer {
 public:
  Enhancer(const BenchOptions& options, const Topology& coarse, const SubdivisionSpec& subdivision)
      : service_(options.models, "auto", options.out / "logs" / "superres-refinement.log"),
        model_(service_.describe(options.model)),
        cache_(0),
        session_(setup(model_, coarse, subdivision), {}, cache_),
        stream_(service_.stream()) {
    request_.mutable_open()->set_model(model_.model());
    request_.mutable_open()->set_topology_hash(topology_hash(coarse));
    request_.mutable_open()->set_window(1);
    v1::ConversionOpened conversion;
    session_.describe(false, &conversion);
    if (conversion.has_constants()) *request_.mutable_open()->mutable_constants() = conversion.constants();
    stream_->open(request_);
  }

  /// The fine positions before refinement. coarse: with velocities.
  Positions enhance(const Frame& coarse) {
    v1::ToImageRequest image;
    *image.mutable_frame() = to_message(coarse);
    session_.encode(image, request_.mutable_frame());
    v1::ImageFrame answer = upscale(*stream_, request_);
    answer.mutable_coarse()->Swap(image.mutable_frame());
    v1::MeshFrame mesh;
    session_.decode(answer, &mesh);
    return positions_from_message(mesh.fine());
  }

 private:
  static v1::ConversionSetup setup(const v1::ModelDescription& model, const Topology& coarse,
                                   const SubdivisionSpec& subdivision) {
    v1::ConversionSetup setup;
    *setup.mutable_coarse() = to_message(coarse);
    *setup.mutable_representation() = model.representation();
    set_subdivision(subdivision, setup.mutable_representation());
    return setup;
  }

  SuperresProcess service_;
  v1::ModelDescription model_;
  conversion::RepresentationCache cache_;
  conversion::Session session_;
  std::unique_ptr<SuperresProcess::Stream> stream_;
  v1::UpscaleRequest request_;
};

void visit_dataset(const BenchOptions& options, const std::function<void(const RefinementSetting&)>& begin,
                   const std::function<void(const RefinementInput&)>& visit) {
  const DatasetReader dataset(options.dataset);
  RefinementSetting setting;
  setting.coarse = dataset.topology().coarse;
  const SubdivisionSpec subdivision = subdivision_of(dataset.topology());
  setting.subdivision = subdivide(setting.coarse, subdivision);
  setting.range = dataset.master().normalization;
  Enhancer enhancer(options, setting.coarse, subdivision);
  std::string sequence;
  for (const FramePlace& place : choose_frames(dataset, options.frames)) {
    if (place.sequence.name != sequence) {
      sequence = place.sequence.name;
      setting.shapes = place.sequence.obstacles;
      begin(setting);
    }
    FramePair pair = read_pair(dataset, place);
    RefinementInput input;
    input.name = sequence + ", frame " + std::to_string(place.index);
    input.fine = enhancer.enhance(pair.coarse);
    input.coarse = std::move(pair.coarse.positions);
    input.reference = std::move(pair.fine.positions);
    input.obstacles = std::move(dataset.obstacles(sequence, place.index, place.index + 1).at(0));
    visit(input);
  }
}

void visit_scene(const BenchOptions& options, const std::function<void(const RefinementSetting&)>& begin,
                 const std::function<void(const RefinementInput&)>& visit) {
  simulation::Simulation simulation(load_bench_scene(scene_or(options, "hitting"), options.frames),
                                    simulation::Mode::kCoarse);
  RefinementSetting setting;
  setting.coarse = simulation.coarse();
  setting.subdivision = subdivide(setting.coarse, simulation.scene().subdivision_rounds);
  setting.shapes = simulation.obstacle_shapes();
  begin(setting);
  for (std::size_t k = 0; k <= options.frames; ++k) {
    simulation::SimulatedFrame frame = simulation.next_frame();
    RefinementInput input;
    input.name = "frame " + std::to_string(k);
    input.fine = upsample(setting.subdivision, setting.coarse.faces, frame.coarse.positions);
    add_wrinkles(setting.subdivision.fine, 0.004, 0.04, 0.2 * static_cast<double>(k), input.fine);
    input.coarse = std::move(frame.coarse.positions);
    input.obstacles = std::move(frame.obstacles);
    visit(input);
  }
}

}  // namespace

simulation::Scene load_bench_scene(const std::filesystem::path& file, std::size_t frames) {
  return cut(presentation::read_scene_file(file), frames);
}

simulation::Scene parse_bench_scene(const std::string& json, std::size_t frames) {
  return cut(presentation::parse_scene(json, "scene", shipped_file("scenes")), frames);
}

FramePair wrinkled_pair(const Topology& coarse, const Subdivision& subdivision, double phase) {
  FramePair pair;
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

std::vector<FramePlace> choose_frames(const DatasetReader& dataset, std::size_t count) {
  std::vector<SequenceInfo> sequences = dataset.sequences();
  const bool any_test = std::any_of(sequences.begin(), sequences.end(),
                                    [](const auto& s) { return s.split == "test" && s.frames_complete > 0; });
  std::erase_if(sequences, [&](const auto& s) { return s.frames_complete == 0 || (any_test && s.split != "test"); });
  std::vector<FramePlace> all, chosen;
  for (const SequenceInfo& sequence : sequences) {
    for (std::uint64_t k = 0; k < sequence.frames_complete; ++k) all.push_back({sequence, k});
  }
  if (all.empty()) throw_not_found(dataset.folder().string() + ": no sequence with frames");
  count = std::min(count, all.size());
  for (std::size_t i = 0; i < count; ++i) chosen.push_back(all[(2 * i + 1) * all.size() / (2 * count)]);
  return chosen;
}

FramePair read_pair(const DatasetReader& dataset, const FramePlace& place) {
  const std::uint64_t first = place.index > 0 ? place.index - 1 : 0;
  const auto frame = [&](std::vector<Positions> positions) {
    Frame result;
    result.index = place.index;
    result.velocities = backward_velocities(positions.back(), positions.front(), dataset.master().frame_time_s);
    result.positions = std::move(positions.back());
    return result;
  };
  return {frame(dataset.coarse(place.sequence.name, first, place.index + 1)),
          frame(dataset.fine(place.sequence.name, first, place.index + 1))};
}

void visit_refinement_inputs(const BenchOptions& options, const std::function<void(const RefinementSetting&)>& begin,
                             const std::function<void(const RefinementInput&)>& visit) {
  (options.dataset.empty() ? visit_scene : visit_dataset)(options, begin, visit);
}

}  // namespace pleat::evaluation
