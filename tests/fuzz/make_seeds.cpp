// Writes the seeds of the corpora: whole, small sessions, from which the fuzzers start.
// Usage: fuzz_make_seeds FOLDER SOURCES, the second being the project's root.
#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>

#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/scene/animation_parts.hpp"
#include "pleat/v1/conversion.pb.h"
#include "pleat/v1/fold.pb.h"
#include "pleat/v1/refinement.pb.h"
#include "services/coordinator/service.hpp"
#include "services/simulation/service.hpp"
#include "services/superres/bundle/folder.hpp"
#include "tests/fuzz/message_fuzzer.hpp"
#include "tests/fuzz/stream_fuzzer.hpp"
#include "tests/support/fake_coordinator.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::fuzz {
namespace {

template <typename Request>
void write(const std::filesystem::path& file, const std::vector<Request>& messages) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << write_messages(messages);
}

Frame frame_of(const Topology& mesh, std::uint64_t index, float bump) {
  Frame frame;
  frame.index = index;
  frame.time_s = 0.04 * static_cast<double>(index);
  frame.positions = mesh.rest_positions;
  for (Eigen::Index v = 0; v < frame.positions.rows(); ++v) {
    frame.positions(v, 1) += bump * std::sin(9 * mesh.rest_positions(v, 0));
  }
  frame.velocities = Positions::Constant(frame.positions.rows(), 3, 0.1f);
  return frame;
}

// Two charts and a seam between them.
Topology two_charts() {
  Topology mesh = test::square_sheet(2, 1);
  mesh.uv.conservativeResize(18, 2);
  mesh.uv.bottomRows(9) = mesh.uv.topRows(9);
  mesh.uv.bottomRows(9).col(0).array() += 1.5f;
  mesh.uv_faces.bottomRows(4).array() += 9u;
  return mesh;
}

void conversion_seeds(const std::filesystem::path& folder) {
  int count = 0;
  for (const Topology& coarse : {test::square_sheet(3, 1), two_charts()}) {
    for (const std::uint32_t rounds : {1u, 2u}) {
      v1::ConversionSetup setup;
      *setup.mutable_coarse() = to_message(coarse);
      setup.mutable_coarse()->clear_hash();
      v1::Representation& representation = *setup.mutable_representation();
      representation.set_subdivision_rounds(rounds);
      v1::GeometryImage& image_size = *representation.mutable_geometry_image();
      image_size.set_scale(2);
      image_size.set_width(8);
      image_size.set_height(6);
      for (int c = 0; c < 9; ++c) {
        representation.mutable_input()->add_offset(-1);
        representation.mutable_input()->add_scale(3);
      }
      *representation.mutable_output() = representation.input();
      const std::string name = "session-" + std::to_string(++count);
      std::vector<v1::ToImageRequest> images(2);
      *images[0].mutable_open()->mutable_setup() = setup;
      *images[1].mutable_frame() = to_message(frame_of(coarse, 1, 0.1f));
      write(folder / "to_image" / name, images);

      std::vector<v1::ToMeshRequest> meshes(2);
      *meshes[0].mutable_open()->mutable_setup() = setup;
      Tensor image{{3, 12, 16}, {"x", "y", "z"}, std::vector<float>(3 * 12 * 16, 0.25f)};
      *meshes[1].mutable_frame()->mutable_image() = to_message(image);
      *meshes[1].mutable_frame()->mutable_alignment() = to_message(RigidTransform{});
      write(folder / "to_mesh" / name, meshes);
    }
  }
  // A fine mesh of its own, the size left to the service, physical values.
  std::vector<v1::ToImageRequest> own(2);
  v1::ConversionSetup& setup = *own[0].mutable_open()->mutable_setup();
  *setup.mutable_coarse() = to_message(test::square_sheet(2, 1));
  *setup.mutable_fine() = to_message(test::square_sheet(5, 1));
  setup.mutable_coarse()->clear_hash();
  setup.mutable_fine()->clear_hash();
  setup.mutable_representation()->mutable_geometry_image();
  *own[1].mutable_frame() = to_message(frame_of(test::square_sheet(2, 1), 0, 0));
  write(folder / "to_image" / "own-fine-mesh", own);

  // A network that reads where a ball and a tetrahedron are.
  std::vector<v1::ToImageRequest> among(2);
  v1::ToImageOpen& open = *among[0].mutable_open();
  *open.mutable_setup()->mutable_coarse() = to_message(test::square_sheet(2, 1));
  open.mutable_setup()->mutable_coarse()->clear_hash();
  v1::Representation& features = *open.mutable_setup()->mutable_representation();
  features.set_subdivision_rounds(1);
  features.mutable_vertex_features()->set_obstacles(true);
  *open.add_obstacles() = to_message(ObstacleShape{"ball", {}});
  ObstacleShape solid;
  solid.name = "solid";
  solid.faces.resize(4, 3);
  solid.faces << 0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3;
  *open.add_obstacles() = to_message(solid);
  *among[1].mutable_frame() = to_message(frame_of(test::square_sheet(2, 1), 0, 0));
  ObstacleFrame ball, tetrahedron;
  ball.name = "ball";
  ball.radius = 0.3f;
  tetrahedron.name = "solid";
  tetrahedron.positions.resize(4, 3);
  tetrahedron.positions << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1;
  *among[1].add_obstacles() = to_message(ball);
  *among[1].add_obstacles() = to_message(tetrahedron);
  write(folder / "to_image" / "among-obstacles", among);
}

// A stream that goes on, one that begins with a state, and one with a start.
void fold_seeds(const std::filesystem::path& folder) {
  const Topology coarse = test::square_sheet(2, 1);
  const Subdivision subdivision = subdivide(coarse, 1);
  std::vector<v1::FoldRequest> messages(4);
  v1::FoldOpen& open = *messages[0].mutable_open();
  *open.mutable_coarse() = to_message(coarse);
  open.mutable_coarse()->clear_hash();
  open.set_subdivision_rounds(1);
  open.set_frame_time_s(0.04);
  *open.add_obstacles() = to_message(ObstacleShape{"ball", {}});
  open.add_handles()->add_vertices(0);
  v1::IsotropicMaterial& material = *open.mutable_material()->mutable_isotropic();
  material.set_density(500);
  material.set_youngs_modulus(1e6);
  material.set_poissons_ratio(0.3);
  material.set_thickness(5e-4);
  for (std::uint64_t k = 0; k < 3; ++k) {
    v1::FoldFrame& frame = *messages[k + 1].mutable_frame();
    *frame.mutable_coarse() = to_message(frame_of(coarse, k, 0.05f));
    *frame.add_obstacles() = to_message(test::sphere("ball", {0.3f, -0.3f, -0.5f}, 0.25f));
  }
  write(folder / "fold" / "session-1", messages);
  const Positions fine = upsample(subdivision, coarse.faces, coarse.rest_positions);
  to_message(fine, messages[1].mutable_frame()->mutable_state()->mutable_positions());
  to_message(Positions::Zero(fine.rows(), 3), messages[1].mutable_frame()->mutable_state()->mutable_velocities());
  write(folder / "fold" / "session-2", messages);
  to_message(fine, messages[2].mutable_frame()->mutable_start());
  write(folder / "fold" / "session-3", messages);
}

void refinement_seeds(const std::filesystem::path& folder) {
  const Topology coarse = test::square_sheet(3, 1);
  const Subdivision subdivision = subdivide(coarse, 2);
  const test::ClosedMesh cube = test::cube(0.2f);
  int count = 0;
  for (const float noise : {0.f, 0.02f, 0.3f}) {
    std::vector<v1::RefineRequest> messages(2);
    v1::RefineOpen& open = *messages[0].mutable_open();
    *open.mutable_coarse() = to_message(coarse);
    open.mutable_coarse()->clear_hash();
    *open.add_obstacles() = to_message(ObstacleShape{"ball", {}});
    *open.add_obstacles() = to_message(ObstacleShape{"cube", cube.faces});
    v1::RefineFrame& frame = *messages[1].mutable_frame();
    *frame.mutable_coarse() = to_message(frame_of(coarse, 0, 0.05f));
    Frame fine = frame_of(subdivision.fine, 0, 0.05f);
    fine.positions += test::noise(fine.positions.rows(), noise, 3);
    fine.velocities.resize(0, 3);
    *frame.mutable_fine() = to_message(fine);
    *frame.add_obstacles() = to_message(test::sphere("ball", {0.3f, -0.3f, -0.5f}, 0.25f));
    ObstacleFrame block;
    block.name = "cube";
    block.positions = cube.positions;
    block.positions.rowwise() += Eigen::RowVector3f(0.7f, -0.26f, -0.4f);
    *frame.add_obstacles() = to_message(block);
    write(folder / "refine" / ("session-" + std::to_string(++count)), messages);
  }
}

// A free fine mesh that falls on a ball, a tracked one with a tool that moves (its animation in parts), and one that
// goes on from a check-point.
void simulation_seeds(const std::filesystem::path& folder) {
  std::vector<v1::SimulateRequest> messages(1);
  v1::SimulateOpen& open = *messages[0].mutable_open();
  open.set_fine(v1::SimulateOpen::FINE_FREE);
  open.set_window(8);
  v1::Scene& scene = *open.mutable_scene();
  scene.set_name("seed");
  *scene.mutable_garment_mesh() = to_message(test::square_sheet(3, 1));
  scene.mutable_garment_mesh()->clear_hash();
  scene.mutable_isotropic()->set_density(500);
  scene.mutable_isotropic()->set_youngs_modulus(1e6);
  scene.mutable_isotropic()->set_poissons_ratio(0.3);
  scene.mutable_isotropic()->set_thickness(5e-4);
  scene.set_frames(3);
  scene.set_steps_per_frame(2);
  scene.set_subdivision_rounds(1);
  scene.set_perturbation_m(1e-3);
  scene.add_handles()->add_vertices(0);
  v1::Obstacle& ball = *scene.add_obstacles();
  ball.set_name("ball");
  for (const double x : {0.5, -0.3, -0.5}) ball.mutable_sphere()->add_center(x);
  ball.mutable_sphere()->set_radius(0.25);
  write(folder / "simulate" / "free", messages);

  std::vector<v1::SimulateRequest> goes_on = messages;
  goes_on[0].mutable_open()->set_checkpoint_interval(1);
  telemetry::Metrics metrics("seeds");
  simulation::SimulationService service({.threads = 1}, metrics);
  const ServedInProcess served(&service);
  const auto stub = v1::Simulation::NewStub(served.channel());
  std::string checkpoint;
  run_stream<v1::SimulateRequest, v1::SimulateResponse>(
      [&](grpc::ClientContext* context) { return stub->Simulate(context); }, goes_on,
      [&](const auto& answer) {
        checkpoint = answer.frame().checkpoint();
        return !answer.has_frame();
      });
  goes_on[0].mutable_open()->set_checkpoint(checkpoint);
  write(folder / "simulate" / "goes-on", goes_on);

  open.set_fine(v1::SimulateOpen::FINE_TRACKED);
  v1::Animation& animation = *ball.mutable_animation();
  animation.set_sample_time_s(0.04);
  for (int k = 0; k < 3; ++k) {
    for (const double x : {0.5, -0.3 + 0.02 * k, -0.5}) animation.add_positions(static_cast<float>(x));
  }
  for (const v1::AnimationPart& part : take_animations(scene, 0)) *messages.emplace_back().mutable_animation() = part;
  messages.emplace_back().set_ack_index(1);
  write(folder / "simulate" / "tracked-and-animated", messages);
}

// For the bundles that fuzz_upscale serves, which lie in these folders.
void upscale_seeds(const std::filesystem::path& folder, const std::filesystem::path& sources) {
  for (const auto& [bundles, name] :
       {std::pair{"tests/unit/services/superres", "python_bundle"}, std::pair{"deploy/models", "sheet-81"}}) {
    const superres::Metadata metadata = superres::read_metadata((sources / bundles).string(), name);
    const superres::Ports ports = superres::ports_of(metadata);
    const auto vertices = static_cast<std::int64_t>(metadata.rest_positions.size() / 3);
    const std::int64_t height = vertices > 0 ? 1 : 4, width = vertices > 0 ? vertices : 5;
    const auto tensor_of = [&](std::int64_t channels) {
      Tensor tensor{{channels, height, width}, {}, {}};
      tensor.values.assign(static_cast<std::size_t>(channels * height * width), 0.25f);
      return tensor;
    };
    std::vector<v1::UpscaleRequest> messages(3);
    v1::UpscaleOpen& open = *messages[0].mutable_open();
    open.set_model(name);
    if (metadata.constants > 0) *open.mutable_constants() = to_message(tensor_of(metadata.constants));
    for (std::uint64_t k = 0; k < 2; ++k) {
      v1::ImageFrame& frame = *messages[k + 1].mutable_frame();
      frame.set_index(k);
      *frame.mutable_image() = to_message(tensor_of(ports.inputs - metadata.constants));
      *frame.mutable_alignment() = to_message(RigidTransform{});
    }
    write(folder / "upscale" / name, messages);
  }
}

// Before the stages that fuzz_enhance has: every detail, and a session that goes on from a check-point.
void enhance_seeds(const std::filesystem::path& folder) {
  testing::FakeStages stages;
  coordinator::CoordinatorService service(coordinator_options(stages), nullptr);
  const ServedInProcess served(&service);
  const auto stub = v1::Coordinator::NewStub(served.channel());
  const Topology coarse = testing::sheet();
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD, v1::DETAIL_BOTH, v1::DETAIL_NONE}) {
    std::vector<v1::EnhanceRequest> messages(3);
    v1::EnhanceOpen& open = *messages[0].mutable_open();
    *open.mutable_coarse() = testing::to_wire(coarse);
    open.mutable_coarse()->clear_hash();
    open.set_detail(detail);
    open.set_checkpoint_interval(2);
    *open.add_obstacles() = to_message(ObstacleShape{"ball", {}});
    open.add_handles()->add_vertices(0);
    for (std::uint64_t k = 0; k < 2; ++k) {
      v1::EnhanceFrame& frame = *messages[k + 1].mutable_frame();
      *frame.mutable_coarse() = testing::fake_coarse_frame(coarse, k);
      *frame.add_obstacles() = to_message(test::sphere("ball", {0.3f, -0.3f, -0.5f}, 0.25f));
    }
    std::string name = v1::Detail_Name(detail);
    std::transform(name.begin(), name.end(), name.begin(), [](char c) { return static_cast<char>(std::tolower(c)); });
    write(folder / "enhance" / name, messages);
    std::string checkpoint;
    run_stream<v1::EnhanceRequest, v1::EnhanceResponse>(
        [&](grpc::ClientContext* context) { return stub->Enhance(context); }, messages,
        [&](const auto& answer) {
          if (!answer.checkpoint().empty()) checkpoint = answer.checkpoint();
          return true;
        });
    if (checkpoint.empty()) std::abort();
    open.set_checkpoint(checkpoint);
    write(folder / "enhance" / (name + "_goes_on"), messages);
  }
}

}  // namespace
}  // namespace pleat::fuzz

int main(int argc, char** argv) {
  if (argc != 3) {
    std::cerr << "usage: fuzz_make_seeds FOLDER SOURCES\n";
    return 2;
  }
  pleat::fuzz::conversion_seeds(argv[1]);
  pleat::fuzz::fold_seeds(argv[1]);
  pleat::fuzz::refinement_seeds(argv[1]);
  pleat::fuzz::simulation_seeds(argv[1]);
  pleat::fuzz::upscale_seeds(argv[1], argv[2]);
  pleat::fuzz::enhance_seeds(argv[1]);
  return 0;
}
