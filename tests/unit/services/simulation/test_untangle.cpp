#include "services/simulation/untangle.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>

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

// A tube about the y axis from `radii[0]` at its bottom (y = 0) to `radii[1]` at its top, normals outwards.
Topology tube(int around, int up, double height, std::array<double, 2> radii) {
  Topology t = sheet(around, up, 0.6, height);
  const auto wrap = [&](std::uint32_t v) {
    const auto row = v / (static_cast<std::uint32_t>(around) + 1),
               column = v % (static_cast<std::uint32_t>(around) + 1);
    return row * static_cast<std::uint32_t>(around) + column % static_cast<std::uint32_t>(around);
  };
  t.uv_faces = t.faces;
  t.faces = t.faces.unaryExpr(wrap).eval();
  t.rest_positions.resize(around * (up + 1), 3);
  for (int j = 0; j <= up; ++j) {
    const double share = static_cast<double>(j) / up, radius = radii[1] + share * (radii[0] - radii[1]);
    for (int i = 0; i < around; ++i) {
      const double angle = 2 * std::numbers::pi * (i + 0.5 * (j % 2)) / around;
      t.rest_positions.row(j * around + i) << static_cast<float>(radius * std::cos(angle)),
          static_cast<float>(height * (1 - share)), static_cast<float>(-radius * std::sin(angle));
    }
  }
  return t;
}

TEST(Untangle, KeepsTheOrderOfLayers) {
  // The lower half of the outer tube has gone into the inner one: no part of either is the smaller one.
  const Topology inner = tube(16, 6, 0.3, {0.11, 0.09}), outer = tube(14, 5, 0.3, {0.08, 0.13});
  Scene scene = sheet_scene(4);
  scene.garment = inner;
  Topology& both = scene.garment;
  const Eigen::Index vertices = inner.vertex_count(), places = inner.uv.rows(), faces = inner.face_count();
  both.rest_positions.conservativeResize(vertices + outer.vertex_count(), 3);
  both.rest_positions.bottomRows(outer.vertex_count()) = outer.rest_positions;
  both.uv.conservativeResize(places + outer.uv.rows(), 2);
  both.uv.bottomRows(outer.uv.rows()) = outer.uv.rowwise() + Eigen::RowVector2f(3, 0);
  both.faces.conservativeResize(faces + outer.face_count(), 3);
  both.faces.bottomRows(outer.face_count()) = outer.faces.array() + static_cast<std::uint32_t>(vertices);
  both.uv_faces.conservativeResize(faces + outer.face_count(), 3);
  both.uv_faces.bottomRows(outer.face_count()) = outer.uv_faces.array() + static_cast<std::uint32_t>(places);
  scene.layers = {{"trousers", faces}, {"shirt", outer.face_count()}};
  EXPECT_THAT(refusal(scene), testing::AllOf(HasSubstr("of 'trousers' and"), HasSubstr("of 'shirt' intersect")));
  for (const Mode mode : {Mode::kCoarse, Mode::kTrackedFine}) {
    const Outcome outcome = untangled(scene, mode);
    EXPECT_EQ(outcome.self_intersections, 0);
    EXPECT_LT(outcome.largest_move, 0.06f);
  }
  scene.untangle = true;
  const Positions start = Simulation(scene, Mode::kCoarse).next_frame().coarse.positions;
  // As nothing crosses, one place of the lower ends tells who is outside.
  const auto radius = [&](Eigen::Index v) { return std::hypot(start(v, 0), start(v, 2)); };
  float inside = 0, outside = 1;
  for (Eigen::Index v = vertices - 16; v < vertices; ++v) inside = std::max(inside, radius(v));
  for (Eigen::Index v = start.rows() - 14; v < start.rows(); ++v) outside = std::min(outside, radius(v));
  EXPECT_GT(outside, 0.95f * inside);
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
