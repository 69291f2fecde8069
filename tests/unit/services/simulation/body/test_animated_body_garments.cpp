// The garments of deploy/garments that the shipped body wears.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/obj.hpp"
#include "services/simulation/body/animated_body.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/support/cgal_judge.hpp"

namespace pleat::body {
namespace {

struct Garment {
  const char* name;
  int vertices, boundary, euler;
  int fine_vertices;  // after two rounds of splitting edges, or three
  int rounds;
};

class WornGarments : public testing::TestWithParam<Garment> {};

/// Vertices after rounds of splitting every edge: V + E, with E edges and F faces that grow with it.
int refined_vertices(int vertices, int edges, int faces, int boundary, int rounds) {
  for (int round = 0; round < rounds; ++round) {
    vertices += edges;
    edges = 2 * edges + 3 * faces;
    faces *= 4;
    boundary *= 2;
  }
  EXPECT_EQ(3 * faces + boundary, 2 * edges);
  return vertices;
}

TEST_P(WornGarments, HaveThePapersTopologyAndEncloseTheBodyCleanly) {
  const Garment& expected = GetParam();
  const std::filesystem::path deploy = std::filesystem::path(std::getenv("PLEAT_SOURCE_DIR")) / "deploy";
  const Topology garment = read_obj(deploy / "garments" / (std::string(expected.name) + ".obj"));
  validate_material_coordinates(garment, expected.name);
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (Eigen::Index f = 0; f < garment.face_count(); ++f)
    for (int k = 0; k < 3; ++k) ++edges[std::minmax(garment.faces(f, k), garment.faces(f, (k + 1) % 3))];
  const auto boundary = std::count_if(edges.begin(), edges.end(), [](const auto& edge) { return edge.second == 1; });
  const int vertices = static_cast<int>(garment.vertex_count()), faces = static_cast<int>(garment.face_count());
  EXPECT_EQ(vertices, expected.vertices);
  EXPECT_EQ(boundary, expected.boundary);
  EXPECT_EQ(vertices - static_cast<int>(edges.size()) + faces, expected.euler);
  EXPECT_EQ(refined_vertices(vertices, static_cast<int>(edges.size()), faces, expected.boundary, expected.rounds),
            expected.fine_vertices);

  const SkinnedMesh body = *read_character_file(deploy / "bodies/young-female.glb").body;
  ObstacleShape shape;
  shape.name = "body";
  shape.faces = body.mesh.faces;
  ObstacleFrame frame;
  frame.name = "body";
  frame.positions = body.mesh.rest_positions;
  const auto judgement = test::judge(garment.rest_positions, garment.faces, {&shape, 1}, {&frame, 1});
  EXPECT_TRUE(judgement.clean()) << judgement.first;
}

/// The shipped woman begins her dance, at once; what she wears is still missing.
simulation::Scene dancer_scene() {
  const std::filesystem::path deploy = std::filesystem::path(std::getenv("PLEAT_SOURCE_DIR")) / "deploy";
  const AnimatedBody dancer({deploy / "bodies/young-female.glb", deploy / "bodies/lambada.amc", ""}, {.ease_frames = 5},
                            Skinning::kLinear);
  simulation::Scene scene;
  scene.name = "dancer";
  scene.material = simulation::read_material(deploy / "materials/isotropic-medium.json");
  scene.frames = 13;
  scene.steps_per_frame = 4;
  scene.contact.obstacle_friction = 0.6;
  scene.threads = 1;
  simulation::Obstacle body;
  body.name = "body";
  body.mesh = dancer.mesh().mesh;
  for (std::size_t k = 0; k < 14; ++k) body.animation.samples.push_back(dancer.positions(k));
  scene.obstacles.push_back(body);
  return scene;
}

Topology shipped_garment(const std::string& name) {
  return read_obj(std::filesystem::path(std::getenv("PLEAT_SOURCE_DIR")) / "deploy/garments" / (name + ".obj"));
}

void expect_to_stay_on_and_clean(const simulation::Scene& scene) {
  simulation::Simulation simulation(scene, simulation::Mode::kCoarse);
  const auto shapes = simulation.obstacle_shapes();
  const float top = scene.garment.rest_positions.col(1).maxCoeff();
  for (int k = 0; k < scene.frames; ++k) {
    const simulation::SimulatedFrame frame = simulation.next_frame();
    EXPECT_EQ(frame.report.cut_steps, 0u) << k;
    EXPECT_GT(frame.coarse.positions.col(1).maxCoeff(), top - 0.12f) << k;
    if (k % 4 != 0) continue;
    const auto judgement = test::judge(frame.coarse.positions, scene.garment.faces, shapes, frame.obstacles);
    EXPECT_TRUE(judgement.clean()) << k << ": " << judgement.first;
  }
}

TEST_P(WornGarments, StayOnTheDancerAndClean) {
  simulation::Scene scene = dancer_scene();
  scene.garment = shipped_garment(GetParam().name);
  expect_to_stay_on_and_clean(scene);
}

TEST(Outfit, TShirtOverTrousersIsUntangledInThatOrderAndStaysClean) {
  simulation::Scene scene = dancer_scene();
  const Topology trousers = shipped_garment("trousers"), shirt = shipped_garment("t-shirt");
  scene.garment = join_garments({trousers, shirt});
  scene.layers = {{"trousers", trousers.face_count()}, {"t-shirt", shirt.face_count()}};
  try {
    simulation::Simulation(scene, simulation::Mode::kCoarse);
    FAIL() << "the shirt's hem is inside the trousers";
  } catch (const Error& e) {
    EXPECT_THAT(e.what(), testing::ContainsRegex("faces [0-9]+ of 'trousers' and [0-9]+ of 't-shirt' intersect"));
  }
  scene.untangle = true;
  expect_to_stay_on_and_clean(scene);
  // Nothing crosses, and the hem, at 0.8 m, is before the nearest face of the trousers: it is outside.
  scene.frames = 1;
  const Positions start = simulation::Simulation(scene, simulation::Mode::kCoarse).next_frame().coarse.positions;
  const auto point = [&](Eigen::Index v) { return Eigen::Vector3d(start.row(v).cast<double>().transpose()); };
  for (Eigen::Index v = trousers.vertex_count(); v < start.rows(); ++v) {
    if (start(v, 1) > 0.85f) continue;
    double nearest = 1e9, height = 0;
    for (Eigen::Index f = 0; f < trousers.face_count(); ++f) {
      const Eigen::Vector3d a = point(trousers.faces(f, 0)), b = point(trousers.faces(f, 1)),
                            c = point(trousers.faces(f, 2));
      const Eigen::Vector3d weights = closest_on_triangle(point(v), a, b, c);
      const Eigen::Vector3d way = point(v) - weights[0] * a - weights[1] * b - weights[2] * c;
      if (way.norm() >= nearest) continue;
      nearest = way.norm();
      height = way.dot((b - a).cross(c - a));
    }
    EXPECT_GT(height, 0) << "vertex " << v - trousers.vertex_count();
  }
}

INSTANTIATE_TEST_SUITE_P(Garments, WornGarments,
                         testing::Values(Garment{"long-skirt", 1303, 175, 0, 19798, 2},
                                         Garment{"t-shirt", 246, 60, -2, 14190, 3},
                                         Garment{"trousers", 200, 32, -1, 11967, 3},
                                         Garment{"skirt-219", 219, 60, 0, 12336, 3},
                                         Garment{"skirt-127", 127, 47, 0, 6812, 3}),
                         [](const auto& info) {
                           std::string name = info.param.name;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

}  // namespace
}  // namespace pleat::body
