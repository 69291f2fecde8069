// Scenes made to break contact. After every frame CGAL judges the floats that the engine gives out: no face cuts
// another one or an obstacle, nothing is inside an obstacle. Nothing explodes either.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "services/simulation/simulation.hpp"
#include "tests/support/cgal_judge.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using test::judge;
using test::Judgement;

struct Outcome {
  std::uint64_t contacts = 0, impacts = 0, cut_steps = 0;
  Positions first, last;
};

// Stops at the first frame that is not clean or not bounded.
Outcome run(const Scene& scene, int frames, double speed_limit, Mode mode = Mode::kCoarse) {
  Simulation simulation(scene, mode);
  const std::vector<ObstacleShape> shapes = simulation.obstacle_shapes();
  Outcome outcome;
  for (int k = 0; k < frames; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    if (k == 0) outcome.first = frame.coarse.positions;
    outcome.last = frame.coarse.positions;
    outcome.contacts += frame.report.contacts;
    outcome.impacts += frame.report.impacts;
    outcome.cut_steps += frame.report.cut_steps;
    const auto check = [&](const Frame& mesh, const Faces& faces, const char* name) {
      const Judgement judgement = judge(mesh.positions, faces, shapes, frame.obstacles);
      EXPECT_TRUE(judgement.clean()) << name << " frame " << k << ": " << judgement.self_intersections
                                     << " self-intersections, " << judgement.penetrations << " penetrations, first "
                                     << judgement.first;
      const double fastest = static_cast<double>(mesh.velocities.rowwise().norm().maxCoeff());
      EXPECT_LT(fastest, speed_limit) << name << " frame " << k;
    };
    check(frame.coarse, simulation.coarse().faces, "coarse");
    if (frame.fine) check(*frame.fine, simulation.fine().faces, "fine");
    if (testing::Test::HasFailure()) break;
  }
  return outcome;
}

Obstacle box(const std::string& name, const Vector3d& size, const Vector3d& center) {
  Obstacle o;
  o.name = name;
  o.mesh = box_mesh(1);
  o.mesh.rest_positions *= size.cast<float>().asDiagonal();
  o.center = center;
  return o;
}

Obstacle sphere(const std::string& name, const Vector3d& center, double radius) {
  Obstacle o;
  o.name = name;
  o.center = center;
  o.radius = radius;
  return o;
}

// How many faces a vertical line meets.
int layers_at(const Positions& x, const Faces& faces, float px, float pz) {
  int count = 0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    float sides[3];
    for (int k = 0; k < 3; ++k) {
      const auto a = x.row(faces(f, k)), b = x.row(faces(f, (k + 1) % 3));
      sides[k] = (b(0) - a(0)) * (pz - a(2)) - (b(2) - a(2)) * (px - a(0));
    }
    count += (sides[0] > 0 && sides[1] > 0 && sides[2] > 0) || (sides[0] < 0 && sides[1] < 0 && sides[2] < 0);
  }
  return count;
}

TEST(Judge, FindsWhatIsPlanted) {
  const Topology flat = sheet(4, 4, 0.4, 0.4);
  EXPECT_TRUE(judge(flat.rest_positions, flat.faces, {}, {}).clean());
  // A corner folded over and pushed through the sheet by a hair.
  Positions x = flat.rest_positions;
  x(19, 1) = x(23, 1) = 0.01f;
  x.row(24) << 0.013f, -1e-6f, 0.017f;
  EXPECT_GT(judge(x, flat.faces, {}, {}).self_intersections, 0u);
  x.row(24) << 0.013f, 1e-6f, 0.017f;
  EXPECT_TRUE(judge(x, flat.faces, {}, {}).clean());
  // Faces without area.
  x.row(24) = x.row(23);
  EXPECT_GT(judge(x, flat.faces, {}, {}).self_intersections, 0u);

  const auto judged = [&](const Obstacle& o) {
    Scene scene;
    scene.obstacles = {o};
    const std::vector<ObstacleFrame> frames = obstacle_frames(scene, 0);
    const std::vector<ObstacleShape> shapes{{o.name, o.mesh.faces, static_cast<std::uint32_t>(o.capsules.size())}};
    return judge(flat.rest_positions, flat.faces, shapes, frames);
  };
  // A sphere and a capsule from below: their tops are between the vertices.
  EXPECT_TRUE(judged(sphere("ball", {0.03, -0.1001, 0.05}, 0.1)).clean());
  EXPECT_GT(judged(sphere("ball", {0.03, -0.0999, 0.05}, 0.1)).penetrations, 0u);
  Obstacle arm;
  arm.name = "arm";
  arm.capsules = {{{-1, -0.1, 0.02}, {1, -0.1, 0.02}, 0.0999}};
  EXPECT_TRUE(judged(arm).clean());
  arm.capsules[0].radius = 0.1001;
  EXPECT_GT(judged(arm).penetrations, 0u);
  // A box that only its corner reaches through; one that holds the whole sheet.
  Obstacle corner = box("corner", {0.1, 0.1, 0.1}, {0.02, -0.05001, 0.02});
  EXPECT_TRUE(judged(corner).clean());
  corner.center.y() = -0.04999;
  EXPECT_GT(judged(corner).penetrations, 0u);
  EXPECT_EQ(judged(box("room", {2, 2, 2}, {0, 0, 0})).penetrations, 25u);
}

TEST(NastyScene, TenPleatsFallOntoEachOther) {
  constexpr int kLayers = 10, kCells = 4, kAcross = 5;
  const double cell = 0.03, rise = 0.012 / kCells;
  Scene scene = sheet_scene();
  scene.garment = sheet(kLayers * kCells, kAcross, 1, kAcross * cell);
  const double along = std::hypot(cell, rise);
  for (Eigen::Index v = 0; v < scene.garment.vertex_count(); ++v) {
    const auto i = static_cast<int>(v % (kLayers * kCells + 1));
    const int phase = i % (2 * kCells);
    const double x = cell * (phase <= kCells ? phase : 2 * kCells - phase);
    scene.garment.rest_positions(v, 0) = static_cast<float>(x);
    scene.garment.rest_positions(v, 1) = static_cast<float>(rise * i);
    scene.garment.uv(v, 0) = static_cast<float>(along * i);
  }
  scene.material = plain_material(60, 2e-6);
  scene.perturbation_m = 5e-4;
  scene.obstacles.push_back(box("floor", {1, 0.1, 1}, {0.06, -0.07, 0}));
  const Outcome outcome = run(scene, 40, 2.5);
  EXPECT_EQ(layers_at(outcome.first, scene.garment.faces, 0.0617f, 0.0113f), kLayers);
  // They lie on each other, all ten, in half of the height.
  EXPECT_EQ(layers_at(outcome.last, scene.garment.faces, 0.0617f, 0.0113f), kLayers);
  EXPECT_LT(outcome.last.col(1).maxCoeff(), 0.04f);
  EXPECT_GT(outcome.contacts, 10'000u);
}

TEST(NastyScene, SphereAtTwentyMetresASecond) {
  // 100 mm a step: more than its own radius, and several faces. The cloth is held by two corners.
  for (const Mode mode : {Mode::kCoarse, Mode::kTrackedFine}) {
    Scene scene = sheet_scene(mode == Mode::kCoarse ? 10 : 4);
    scene.perturbation_m = 1e-3;
    scene.handles.push_back(handle_on({0, mode == Mode::kCoarse ? 10u : 4u}));
    scene.obstacles.push_back(sphere("bullet", {0.03, -1.2, 0.05}, 0.07));
    // Smooth ends: the speed in the middle, where the cloth is, is 1.5 times the mean.
    scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.18, {0, 2.4, 0}, {0, 0, 0}}};
    const Outcome outcome = run(scene, mode == Mode::kCoarse ? 24 : 9, 40, mode);
    EXPECT_GT(outcome.impacts, 50u);
  }
}

TEST(NastyScene, HandlePullsTheClothThroughItself) {
  // The near half is held taut at both ends. The free end's middle is taken over it, down through it by 0.25 m and up
  // again: there is no way through, and the script does not care.
  Scene scene = sheet_scene();
  scene.garment = sheet(16, 6, 0.8, 0.3);
  scene.material = plain_material(100, 1e-5);
  Handle held, driven;
  for (std::uint32_t j = 0; j <= 6; ++j) {
    held.vertices.push_back(j * 17);
    held.vertices.push_back(j * 17 + 8);
  }
  driven.vertices = {3 * 17 + 16};
  held.hard = driven.hard = true;
  driven.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}},
                        {0.4, {-0.3, 0.25, 0}, {0, 0, 0}},
                        {0.7, {-0.6, 0.1, 0.02}, {0, 0, 0}},
                        {1.1, {-0.6, -0.25, 0.02}, {0, 0, 0}},
                        {1.4, {-0.6, 0.1, 0.02}, {0, 0, 0}}};
  scene.handles = {held, driven};
  const Outcome outcome = run(scene, 36, 8);
  EXPECT_GT(outcome.contacts, 100u);
}

TEST(NastyScene, PinchedBetweenTwoBoxes) {
  // The jaws close to 4 mm, less than twice the repulsion layer, rub past each other, and then to nothing: they must
  // wait there for the cloth between them. At last they open.
  Scene scene = sheet_scene(10);
  scene.perturbation_m = 1e-3;
  scene.obstacles.push_back(box("upper", {0.2, 0.1, 0.15}, {0, 0.08, 0}));
  scene.obstacles.push_back(box("lower", {0.16, 0.1, 0.2}, {0, -0.08, 0.01}));
  const double closed = 0.028;
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}},
                                    {0.2, {0, -closed, 0}, {0, 0, 0}},
                                    {0.5, {0.05, -closed, 0.02}, {0, 0.3, 0}},
                                    {0.6, {0.05, -closed - 0.01, 0.02}, {0, 0.3, 0}},
                                    {0.8, {0.05, 0, 0.02}, {0, 0.3, 0}}};
  scene.obstacles[1].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}},
                                    {0.2, {0, closed, 0}, {0, 0, 0}},
                                    {0.5, {-0.05, closed, -0.02}, {0, -0.3, 0}},
                                    {0.6, {-0.05, closed + 0.01, -0.02}, {0, -0.3, 0}},
                                    {0.8, {-0.05, 0, -0.02}, {0, -0.3, 0}}};
  const Outcome outcome = run(scene, 26, 8);
  EXPECT_GT(outcome.contacts, 500u);
}

TEST(NastyScene, PinchedBetweenAnArmAndABody) {
  // Two capsules, as an armpit: the arm closes on the body with the cloth between them, and opens again.
  Scene scene = sheet_scene(10);
  scene.transform.rotation = {0, 0, std::numbers::pi / 2};  // hangs in the plane x = 0
  Handle top;
  for (std::uint32_t j = 0; j <= 10; ++j) top.vertices.push_back(j * 11 + 10);
  scene.handles.push_back(top);
  Obstacle body, arm;
  body.name = "body";
  body.capsules = {{{-0.12, -0.5, 0}, {-0.12, 0.2, 0}, 0.1}};
  arm.name = "arm";
  arm.capsules = {{{0.09, 0.1, -0.02}, {0.22, -0.3, 0.02}, 0.04}, {{0.22, -0.3, 0.02}, {0.3, -0.5, 0.1}, 0.035}};
  arm.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}},
                     {0.4, {-0.024, 0, 0}, {0, 0, 0.12}},
                     {0.6, {-0.031, 0, 0.03}, {0, 0.1, 0.12}},
                     {0.9, {0, 0, 0}, {0, 0, 0}}};
  scene.obstacles = {body, arm};
  const Outcome outcome = run(scene, 26, 8);
  EXPECT_GT(outcome.contacts, 500u);
}

TEST(NastyScene, APinchedSpotDoesNotStopTheRest) {
  // Two spheres close on the middle of a falling sheet, and their script takes them 5 mm into each other: they must
  // wait there for the cloth between them. Its border hangs down all the same.
  Scene scene = sheet_scene(10);
  scene.perturbation_m = 1e-3;
  scene.obstacles = {sphere("upper", {0, 0.13, 0}, 0.1), sphere("lower", {0.004, -0.13, 0.003}, 0.1)};
  for (const int k : {0, 1}) {
    scene.obstacles[static_cast<std::size_t>(k)].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}},
                                                                {0.12, {0, k == 0 ? -0.0325 : 0.0325, 0}, {0, 0, 0}}};
  }
  Simulation simulation(scene, Mode::kCoarse);
  std::vector<std::string> warnings;
  std::uint64_t cut = 0;
  float corner_before = 0;
  for (int k = 0; k < 12; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    const Positions& x = frame.coarse.positions;
    ASSERT_TRUE(judge(x, simulation.coarse().faces, simulation.obstacle_shapes(), frame.obstacles).clean()) << k;
    EXPECT_LT(frame.coarse.velocities.rowwise().norm().maxCoeff(), 8) << k;
    cut += frame.report.cut_steps;
    warnings.insert(warnings.end(), frame.warnings.begin(), frame.warnings.end());
    if (k == 5) corner_before = x(0, 1);
    if (k == 11) {
      EXPECT_LT(x(0, 1), corner_before - 0.02F);
    }
  }
  EXPECT_GT(cut, 0u);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("cut"), std::string::npos) << warnings[0];
}

TEST(NastyScene, HandleIsLedIntoAnObstacle) {
  // A hard handle takes the middle of the sheet down into a box and up again: it waits on the box, where only it is
  // held up. The rest of the sheet falls on.
  Scene scene = sheet_scene(8);
  Handle middle = handle_on({40});
  middle.hard = true;
  middle.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.3, {0.01, -0.08, 0}, {0, 0, 0}}, {0.5, {0, 0.02, 0}, {0, 0, 0}}};
  scene.handles.push_back(middle);
  scene.obstacles.push_back(box("box", {0.2, 0.1, 0.2}, {0.01, -0.1, 0.02}));
  Simulation simulation(scene, Mode::kCoarse);
  std::vector<std::string> warnings;
  float corner_before = 0, height = 0;
  std::uint64_t yielded = 0;
  for (int k = 0; k < 20; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    const Positions& x = frame.coarse.positions;
    EXPECT_TRUE(judge(x, simulation.coarse().faces, simulation.obstacle_shapes(), frame.obstacles).clean()) << k;
    EXPECT_LT(frame.coarse.velocities.rowwise().norm().maxCoeff(), 6) << k;
    EXPECT_EQ(frame.report.cut_steps, 0u) << k;
    height = x(40, 1);
    yielded += frame.report.yielded_steps;
    warnings.insert(warnings.end(), frame.warnings.begin(), frame.warnings.end());
    // The script is inside the box from 0.19 to 0.42 s; 0.16 s of free fall are 12 cm.
    if (frame.coarse.time_s < 0.21) corner_before = x(0, 1);
    if (std::abs(frame.coarse.time_s - 0.4) < 1e-6) {
      EXPECT_LT(x(0, 1), corner_before - 0.02F);
    }
    if (std::abs(frame.coarse.time_s - 0.32) < 1e-6) {
      EXPECT_NEAR(x(40, 1), -0.05F, 0.01F);
    }
  }
  EXPECT_GT(yielded, 0u);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("can't follow its script"), std::string::npos) << warnings[0];
  EXPECT_NEAR(height, 0.02F, 1e-4F);  // it goes on once its script allows it
}

TEST(NastyScene, SheetFallsEdgeOnOntoTheCornerOfABox) {
  // The corner points straight up, and the sheet's lower edge comes down on it in the plane of the sheet.
  Scene scene = sheet_scene(10);
  scene.material = plain_material(60, 5e-6);
  scene.transform.rotation = {std::numbers::pi / 2, 0, 0};
  scene.transform.translation = {0.013, 0.27, 0.001};
  scene.velocity = {0, -2, 0};
  scene.obstacles.push_back(box("box", {0.2, 0.2, 0.2}, {0, -0.1 * std::numbers::sqrt3, 0}));
  // Takes the diagonal (1, 1, 1) to the vertical.
  const Vector3d axis = Vector3d(1, 1, 1).cross(Vector3d::UnitY()).normalized();
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, std::acos(1 / std::numbers::sqrt3) * axis}};
  const Outcome outcome = run(scene, 24, 8);
  EXPECT_GT(outcome.contacts + outcome.impacts, 100u);
}

TEST(NastyScene, SheetFallsOnABoxWithAllEdgesParallel) {
  // Nothing is perturbed: edges meet edges in parallel, vertices meet edges exactly, faces lie in the planes of faces.
  Scene scene = sheet_scene(8);
  scene.transform.translation = {0, 0.02, 0};
  scene.obstacles.push_back(box("box", {0.25, 0.125, 0.25}, {0, -0.0625, 0}));
  const Outcome outcome = run(scene, 24, 6);
  EXPECT_GT(outcome.contacts, 500u);
}

}  // namespace
}  // namespace pleat::simulation
