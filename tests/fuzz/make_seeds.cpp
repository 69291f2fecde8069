// Writes the seeds of the corpora: whole, small sessions, from which the fuzzers start. Usage: fuzz_make_seeds FOLDER
#include <filesystem>
#include <fstream>
#include <iostream>

#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "pleat/v1/conversion.pb.h"
#include "pleat/v1/fold.pb.h"
#include "pleat/v1/refinement.pb.h"
#include "tests/fuzz/message_fuzzer.hpp"
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

}  // namespace
}  // namespace pleat::fuzz

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: fuzz_make_seeds FOLDER\n";
    return 2;
  }
  pleat::fuzz::conversion_seeds(argv[1]);
  pleat::fuzz::fold_seeds(argv[1]);
  pleat::fuzz::refinement_seeds(argv[1]);
  return 0;
}
