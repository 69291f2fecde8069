#include "services/simulation/untangle.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"
#include "tests/unit/services/simulation/judge.hpp"

namespace pleat::simulation {
namespace {

using testing::HasSubstr;

std::string refusal(const Scene& scene, Mode mode = Mode::kCoarse) {
  try {
    Simulation simulation(scene, mode);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    return e.what();
  }
  return "accepted";
}

// How far the cloth was moved at most, and whether an independent judge finds the first frames clean. The scene must be
// refused as it is.
struct Outcome {
  float largest_move = 0;
  int self_intersections = 0;
};
Outcome untangled(Scene scene, Mode mode = Mode::kCoarse) {
  Scene plain = scene;
  plain.untangle = false;
  EXPECT_THAT(refusal(plain, mode), HasSubstr("not clean at the start"));
  const Positions start = [&] {
    Scene ghost = scene;  // without contact nothing is unclean
    ghost.contact.self_collision = false;
    ghost.obstacles.clear();
    return Simulation(ghost, Mode::kCoarse).next_frame().coarse.positions;
  }();
  scene.untangle = true;
  Simulation simulation(scene, mode);
  Outcome outcome;
  for (int k = 0; k < 3; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    if (k == 0) outcome.largest_move = (frame.coarse.positions - start).rowwise().norm().maxCoeff();
    outcome.self_intersections += self_intersections(frame.coarse.positions, simulation.coarse().faces);
    if (frame.fine) outcome.self_intersections += self_intersections(frame.fine->positions, simulation.fine().faces);
    for (std::size_t o = 0; o < frame.obstacles.size(); ++o) {
      const ObstacleFrame& obstacle = frame.obstacles[o];
      if (obstacle.positions.rows() == 0) continue;
      // A mesh and the cloth as one mesh: crossings of both count as well.
      Positions both(frame.coarse.positions.rows() + obstacle.positions.rows(), 3);
      both << frame.coarse.positions, obstacle.positions;
      const Faces& cloth = simulation.coarse().faces;
      Faces faces(cloth.rows() + scene.obstacles[o].mesh.faces.rows(), 3);
      faces << cloth,
          (scene.obstacles[o].mesh.faces.array() + static_cast<std::uint32_t>(frame.coarse.positions.rows())).matrix();
      outcome.self_intersections += self_intersections(both, faces);
    }
  }
  return outcome;
}

// A second sheet of the same size, placed by a function of the first one's points.
template <typename Place>
void add_sheet(Scene& scene, const Place& place) {
  const Topology one = scene.garment;
  Topology& both = scene.garment;
  const Eigen::Index n = one.vertex_count();
  both.rest_positions.conservativeResize(2 * n, 3);
  both.uv.conservativeResize(2 * n, 2);
  both.faces.resize(2 * one.face_count(), 3);
  for (Eigen::Index v = 0; v < n; ++v) {
    both.rest_positions.row(n + v) = place(Eigen::RowVector3f(one.rest_positions.row(v)));
    both.uv.row(n + v) = one.uv.row(v) + Eigen::RowVector2f(3, 0);
  }
  both.faces << one.faces, (one.faces.array() + static_cast<std::uint32_t>(n)).matrix();
  both.uv_faces = both.faces;
}

Obstacle ball(const Eigen::Vector3d& center, double radius) {
  Obstacle o;
  o.name = "ball";
  o.center = center;
  o.radius = radius;
  return o;
}

TEST(Untangle, LeavesACleanStartAlone) {
  Scene scene = sheet_scene(5);
  scene.obstacles = {ball({0, -0.2, 0}, 0.1)};
  const Positions plain = Simulation(scene, Mode::kCoarse).next_frame().coarse.positions;
  scene.untangle = true;
  EXPECT_EQ(Simulation(scene, Mode::kCoarse).next_frame().coarse.positions, plain);
}

TEST(Untangle, PushesTheClothOutOfASphere) {
  Scene scene = sheet_scene(8);
  scene.obstacles = {ball({0.01, -0.06, 0.02}, 0.1)};
  for (const Mode mode : {Mode::kCoarse, Mode::kTrackedFine}) {
    const Outcome outcome = untangled(scene, mode);
    EXPECT_EQ(outcome.self_intersections, 0);
    EXPECT_GT(outcome.largest_move, 0.03f);
    EXPECT_LT(outcome.largest_move, 0.08f);
  }
}

TEST(Untangle, PushesTheClothOffACapsuleThatPiercesIt) {
  Scene scene = sheet_scene(8);
  Obstacle pin;
  pin.name = "pin";
  pin.capsules = {{{0.02, -0.5, 0.03}, {0.02, 0.04, 0.03}, 0.004}};
  scene.obstacles = {pin};
  const Outcome outcome = untangled(scene);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_LT(outcome.largest_move, 0.15f);
}

TEST(Untangle, PushesTheClothOutOfAMesh) {
  Scene scene = sheet_scene(8);
  Obstacle box;
  box.name = "box";
  box.mesh = box_mesh(0.2);
  scene.obstacles = {box};
  // Its lid a little above the sheet, with the sheet's vertices inside.
  scene.obstacles[0].center = {0.01, -0.08, 0.02};
  EXPECT_EQ(untangled(scene).self_intersections, 0);
  // On its tip: only the tip pokes through a face.
  scene.obstacles[0].center = {0.02, -0.155, 0.015};
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0.7, 0, 0.65}}};
  const Outcome tip = untangled(scene);
  EXPECT_EQ(tip.self_intersections, 0);
  EXPECT_LT(tip.largest_move, 0.08f);
}

TEST(Untangle, SeparatesWavyLayers) {
  // The upper layer's waves dip through the lower one, in several places.
  Scene scene = sheet_scene(10);
  add_sheet(scene, [](const Eigen::RowVector3f& p) {
    return Eigen::RowVector3f(p.x() + 0.003f, 0.006f + 0.012f * std::sin(25 * p.x()) * std::sin(20 * p.z()), p.z());
  });
  const Outcome outcome = untangled(scene);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_LT(outcome.largest_move, 0.03f);
}

TEST(Untangle, SeparatesLayersThatLieInEachOther) {
  Scene scene = sheet_scene(5);
  add_sheet(scene, [](const Eigen::RowVector3f& p) { return p; });
  const Outcome outcome = untangled(scene);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_LT(outcome.largest_move, 0.01f);
}

TEST(Untangle, PullsAFlapOutOfASlit) {
  // An upright sheet whose lower edge has gone through the lying one.
  Scene scene = sheet_scene(8);
  add_sheet(scene, [](const Eigen::RowVector3f& p) {
    return Eigen::RowVector3f(0.5f * p.x() + 0.01f, 0.23f + p.z(), 0.02f + 0.1f * p.x());
  });
  const Outcome outcome = untangled(scene);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_LT(outcome.largest_move, 0.12f);
}

TEST(Untangle, NamesWhatRemainsWhereItFails) {
  Scene scene = sheet_scene(4);
  scene.untangle = true;
  scene.obstacles = {ball({0, 0, 0}, 1000)};
  const std::string message = refusal(scene);
  EXPECT_THAT(message, HasSubstr("not even after untangling"));
  EXPECT_THAT(message, HasSubstr("'ball'"));
}

TEST(Untangle, IsDeterministicForAnyNumberOfThreads) {
  Scene scene = sheet_scene(8);
  scene.untangle = true;
  scene.obstacles = {ball({0.01, -0.06, 0.02}, 0.1)};
  const Positions one = Simulation(scene, Mode::kCoarse).next_frame().coarse.positions;
  scene.threads = 3;
  EXPECT_EQ(Simulation(scene, Mode::kCoarse).next_frame().coarse.positions, one);
}

}  // namespace
}  // namespace pleat::simulation
