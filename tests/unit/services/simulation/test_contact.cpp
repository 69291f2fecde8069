#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numbers>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/triangle_intersection.hpp"
#include "services/simulation/contact.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"
#include "tests/unit/services/simulation/judge.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

double distance_to_cloth(const Vector3d& p, const Positions& x, const Faces& faces) {
  double best = 1e30;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const auto corner = [&](int k) -> Vector3d { return x.row(faces(f, k)).cast<double>().transpose(); };
    best = std::min(best, closest_vertex_face(p, corner(0), corner(1), corner(2)).squared_distance);
  }
  return std::sqrt(best);
}

struct Outcome {
  int self_intersections = 0;
  double sphere_clearance = 1e30;  // the smallest distance of the cloth from a sphere's surface
  std::uint64_t impacts = 0, contacts = 0, cut_steps = 0, pinched_vertices = 0;
  double lag = 0, last_lag = 0;  // of obstacles behind their script, metres
  Positions last;
};

Outcome run(const Scene& scene, int frames, Mode mode = Mode::kCoarse) {
  Simulation simulation(scene, mode);
  Outcome outcome;
  for (int k = 0; k < frames; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    outcome.self_intersections += self_intersections(frame.coarse.positions, simulation.coarse().faces);
    if (frame.fine) outcome.self_intersections += self_intersections(frame.fine->positions, simulation.fine().faces);
    for (const ObstacleFrame& o : frame.obstacles) {
      if (o.radius <= 0) continue;
      const Vector3d center = o.center.cast<double>();
      outcome.sphere_clearance = std::min(
          outcome.sphere_clearance,
          distance_to_cloth(center, frame.coarse.positions, simulation.coarse().faces) - static_cast<double>(o.radius));
      if (frame.fine) {
        outcome.sphere_clearance = std::min(
            outcome.sphere_clearance,
            distance_to_cloth(center, frame.fine->positions, simulation.fine().faces) - static_cast<double>(o.radius));
      }
    }
    outcome.impacts += frame.report.impacts;
    outcome.contacts += frame.report.contacts;
    outcome.cut_steps += frame.report.cut_steps;
    outcome.pinched_vertices = std::max(outcome.pinched_vertices, frame.report.pinched_vertices);
    outcome.last_lag = frame.report.obstacle_lag_m;
    outcome.lag = std::max(outcome.lag, outcome.last_lag);
    outcome.last = frame.coarse.positions;
  }
  return outcome;
}

Obstacle sphere(const std::string& name, const Vector3d& center, double radius) {
  Obstacle o;
  o.name = name;
  o.center = center;
  o.radius = radius;
  return o;
}

TEST(Contact, ClothRestsOnASphere) {
  Scene scene = sheet_scene(10);
  scene.perturbation_m = 1e-3;
  scene.obstacles.push_back(sphere("ball", {0, -0.13, 0}, 0.1));
  const Outcome outcome = run(scene, 50);
  EXPECT_GT(outcome.contacts, 100u);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_GT(outcome.sphere_clearance, 0);
  // It hangs over the ball and has not fallen off.
  EXPECT_GT(outcome.last.col(1).maxCoeff(), -0.1f);
  EXPECT_LT(outcome.last.col(1).minCoeff(), -0.15f);
}

TEST(Contact, FastSphereDoesNotTunnel) {
  // 5 m/s: 25 mm a step, far more than the repulsion layer; the ball is small against the faces.
  Scene scene = sheet_scene(6);
  scene.gravity.setZero();
  scene.obstacles.push_back(sphere("bullet", {0.02, -0.5, 0.03}, 0.03));
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.2, {0, 1, 0}, {0, 0, 0}}};
  const Outcome outcome = run(scene, 7);
  EXPECT_GT(outcome.impacts, 0u);
  EXPECT_GT(outcome.sphere_clearance, 0);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_GT(outcome.last.col(1).maxCoeff(), 0.4f);  // carried along, not passed
}

TEST(Contact, FoldedClothStaysClean) {
  // Two opposite edges are swapped by hard handles: the sheet must fold onto itself, layer on layer.
  Scene scene = sheet_scene(10);
  scene.perturbation_m = 2e-3;
  Handle left, right;
  for (std::uint32_t j = 0; j <= 10; ++j) {
    left.vertices.push_back(j * 11);
    right.vertices.push_back(j * 11 + 10);
  }
  left.hard = right.hard = true;
  right.motion.keys = {
      {0, {0, 0, 0}, {0, 0, 0}}, {0.5, {-0.5, 0.1, 0}, {0, 0, 2.5}}, {1.2, {-0.7, 0.01, 0}, {0, 0, 3}}};
  scene.handles = {left, right};
  const Outcome outcome = run(scene, 40);
  EXPECT_GT(outcome.contacts, 0u);
  EXPECT_EQ(outcome.self_intersections, 0);
}

TEST(Contact, HandlesThatForceTheClothThroughItselfDoNot) {
  // One edge is lifted over the sheet and driven down through the half of it that is held on both sides.
  Scene scene = sheet_scene(8);
  Handle held, driven;
  for (std::uint32_t i = 0; i <= 8; ++i) {
    held.vertices.push_back(i);
    held.vertices.push_back(4 * 9 + i);
    driven.vertices.push_back(8 * 9 + i);
  }
  held.hard = driven.hard = true;
  driven.motion.keys = {
      {0, {0, 0, 0}, {0, 0, 0}}, {0.4, {0, 0.12, -0.375}, {0, 0, 0}}, {0.8, {0, -0.2, -0.375}, {0, 0, 0}}};
  scene.handles = {held, driven};
  const Outcome outcome = run(scene, 24);
  EXPECT_GT(outcome.contacts, 0u);
  EXPECT_EQ(outcome.self_intersections, 0);
}

TEST(Contact, SqueezedBetweenTwoSpheresNeverPenetrates) {
  // The script moves the balls into each other: there is no room for the cloth, so that they must wait.
  Scene scene = sheet_scene(6);
  scene.gravity.setZero();
  scene.obstacles.push_back(sphere("above", {0, 0.12, 0}, 0.1));
  scene.obstacles.push_back(sphere("below", {0, -0.12, 0}, 0.1));
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.2, {0, -0.05, 0}, {0, 0, 0}}};
  scene.obstacles[1].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.2, {0, 0.05, 0}, {0, 0, 0}}};
  const Outcome outcome = run(scene, 8);
  EXPECT_GT(outcome.cut_steps, 0u);
  EXPECT_GT(outcome.sphere_clearance, 0);
  EXPECT_EQ(outcome.self_intersections, 0);
  // What gave: 6 cm too much of the way of both together.
  EXPECT_GT(outcome.pinched_vertices, 0u);
  EXPECT_GT(outcome.last_lag, 0.025);
  EXPECT_LT(outcome.lag, 0.05);

  // Where they part again nothing is behind its script in the end.
  for (Obstacle& ball : scene.obstacles) ball.motion.keys.push_back({0.4, {0, 0, 0}, {0, 0, 0}});
  EXPECT_EQ(run(scene, 20).last_lag, 0);
}

TEST(Contact, MeshObstaclePushesTheCloth) {
  Scene scene = sheet_scene(8);
  scene.perturbation_m = 1e-3;
  Obstacle box;
  box.name = "box";
  box.mesh = box_mesh(0.2);
  box.center = {0, -0.15, 0};
  box.motion.keys = {{0.2, {0, 0, 0}, {0, 0, 0}}, {0.6, {0, 0.3, 0}, {0, 1, 0}}};
  scene.obstacles.push_back(box);
  Simulation simulation(scene, Mode::kCoarse);
  std::uint64_t contacts = 0;
  for (int k = 0; k < 20; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    contacts += frame.report.contacts;
    EXPECT_EQ(self_intersections(frame.coarse.positions, simulation.coarse().faces), 0);
    const Positions& o = frame.obstacles.at(0).positions;
    ASSERT_EQ(o.rows(), 8);
    const Topology mesh = box_mesh(0.2);
    for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
      for (Eigen::Index g = 0; g < simulation.coarse().face_count(); ++g) {
        Triangle3f a, b;
        for (int c = 0; c < 3; ++c) {
          a[static_cast<std::size_t>(c)] = o.row(mesh.faces(f, c)).transpose();
          b[static_cast<std::size_t>(c)] = frame.coarse.positions.row(simulation.coarse().faces(g, c)).transpose();
        }
        EXPECT_FALSE(triangles_intersect(a, b)) << "frame " << k;
      }
    }
  }
  EXPECT_GT(contacts, 20u);
}

TEST(Contact, TrackedFineClothOnASphereStaysClean) {
  Scene scene = sheet_scene(4);
  scene.perturbation_m = 2e-3;
  scene.obstacles.push_back(sphere("ball", {0, -0.12, 0}, 0.1));
  const Outcome outcome = run(scene, 20, Mode::kTrackedFine);
  EXPECT_GT(outcome.contacts, 100u);
  EXPECT_EQ(outcome.self_intersections, 0);
  EXPECT_GT(outcome.sphere_clearance, 0);
}

TEST(Contact, FrictionHoldsTheClothOnASlopingSphere) {
  // Off-centre on a large ball: with friction it stays longer.
  const auto slide = [](double friction) {
    Scene scene = sheet_scene(6);
    scene.transform.rotation = {0, 0, -0.35};
    scene.transform.translation = {1.05 * std::sin(0.35), 1.05 * std::cos(0.35) - 1.0, 0};
    scene.contact.obstacle_friction = friction;
    scene.obstacles.push_back(sphere("hill", {0, -1.02, 0}, 1));
    return run(scene, 20).last.col(0).mean();
  };
  const float rough = slide(0.8), smooth = slide(0);
  EXPECT_GT(smooth, rough + 0.1f);
}

void expect_refused(const Scene& scene, const std::string& culprit) {
  try {
    Simulation simulation(scene, Mode::kTrackedFine);
    FAIL() << "accepted: " << culprit;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr(culprit));
  }
}

TEST(Contact, ClothThatStartsOnASurfaceRisesSlowly) {
  Scene scene = sheet_scene(4);
  scene.perturbation_m = 0;
  Obstacle table;
  table.name = "table";
  table.mesh = box_mesh(2);
  scene.obstacles = {table};
  for (const double clearance : {1e-4, 2e-3}) {
    scene.transform.translation = {0, 1 + clearance, 0};
    Simulation simulation(scene, Mode::kCoarse);
    double before = clearance, last = 0;
    for (int frame = 0; frame < 25; ++frame) {
      const Positions x = simulation.next_frame().coarse.positions;
      last = static_cast<double>(x.col(1).mean()) - 1;
      EXPECT_LT(std::abs(last - before), 1.5 * ContactSystem::kLayerSpeed * scene.frame_time_s) << frame;
      EXPECT_GT(static_cast<double>(x.col(1).minCoeff()) - 1, 0) << frame;
      before = last;
    }
    EXPECT_GT(last, 4e-3) << "where the layer of 5 mm carries it";
  }
}

TEST(Contact, ATouchIsNotCalledInside) {
  Scene scene = sheet_scene(4);
  Obstacle table;
  table.name = "table";
  table.mesh = box_mesh(2);
  scene.obstacles = {table};
  scene.transform.translation = {0, 1, 0};
  try {
    Simulation simulation(scene, Mode::kCoarse);
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("touches obstacle 'table'"));
    EXPECT_THAT(e.what(), testing::Not(HasSubstr("inside")));
  }
}

TEST(Contact, RefusesAnUncleanStart) {
  Scene scene = sheet_scene();
  scene.obstacles.push_back(sphere("ball", {0, 0.05, 0}, 0.1));
  expect_refused(scene, "'ball'");
  scene.obstacles = {sphere("world", {0, 0, 0}, 10)};  // deep inside: nothing is near its surface
  expect_refused(scene, "'world'");
  Obstacle box;
  box.name = "box";
  box.mesh = box_mesh(0.2);
  scene.obstacles = {box};
  expect_refused(scene, "obstacle");
  scene.obstacles[0].mesh = box_mesh(5);
  expect_refused(scene, "'box'");

  // Two sheets, one of which cuts the other.
  Scene crossed = sheet_scene(2);
  const Topology one = crossed.garment;
  Topology& both = crossed.garment;
  both.rest_positions.conservativeResize(18, 3);
  both.uv.conservativeResize(18, 2);
  both.faces.conservativeResize(16, 3);
  for (int v = 0; v < 9; ++v) {
    both.rest_positions.row(9 + v) << one.rest_positions(v, 0) + 0.02f, one.rest_positions(v, 2), 0.03f;
    both.uv.row(9 + v) = one.uv.row(v) + Eigen::RowVector2f(3, 0);
  }
  both.faces.bottomRows(8) = (one.faces.array() + 9u).matrix();
  both.uv_faces = both.faces;
  expect_refused(crossed, "intersect");
  crossed.contact.self_collision = false;
  EXPECT_NO_THROW(Simulation(crossed, Mode::kCoarse));
}

}  // namespace
}  // namespace pleat::simulation
