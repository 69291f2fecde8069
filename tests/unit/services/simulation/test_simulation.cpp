#include "services/simulation/simulation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"
#include "services/simulation/strain_limits.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using testing::HasSubstr;

// A sheet that hangs by a corner, in contact with a moving ball: everything that carries state is in it.
Scene busy_scene() {
  Scene scene = sheet_scene(5);
  scene.material = read_material("deploy/materials/gray-interlock.json");
  scene.perturbation_m = 2e-3;
  scene.seed = 7;
  scene.frames = 30;
  Handle handle;
  handle.vertices = {0};
  handle.start_s = 0.05;
  handle.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {1, {0.1, 0.1, 0}, {0, 1, 0}}};
  scene.handles.push_back(handle);
  Obstacle ball;
  ball.name = "ball";
  ball.center = {0, -0.12, 0};
  ball.radius = 0.1;
  ball.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {1, {0, 0, 0.3}, {0, 0, 0}}};
  scene.obstacles.push_back(ball);
  return scene;
}

void expect_same(const SimulatedFrame& a, const SimulatedFrame& b) {
  EXPECT_EQ(a.coarse.index, b.coarse.index);
  EXPECT_EQ(a.coarse.positions, b.coarse.positions);
  EXPECT_EQ(a.coarse.velocities, b.coarse.velocities);
  ASSERT_EQ(a.fine.has_value(), b.fine.has_value());
  if (a.fine) {
    EXPECT_EQ(a.fine->positions, b.fine->positions);
    EXPECT_EQ(a.fine->velocities, b.fine->velocities);
  }
  ASSERT_EQ(a.obstacles.size(), b.obstacles.size());
  for (std::size_t o = 0; o < a.obstacles.size(); ++o) EXPECT_EQ(a.obstacles[o].center, b.obstacles[o].center);
}

TEST(Simulation, FirstFrameIsTheInitialState) {
  Scene scene = sheet_scene(4);
  scene.transform.translation = {1, 2, 3};
  scene.transform.rotation = {0, 0, 1.5707963267948966};
  Simulation simulation(scene, Mode::kTrackedFine);
  const SimulatedFrame frame = simulation.next_frame();
  EXPECT_EQ(frame.coarse.index, 0u);
  EXPECT_EQ(frame.coarse.time_s, 0);
  EXPECT_TRUE(frame.coarse.velocities.isZero());
  for (Eigen::Index v = 0; v < frame.coarse.positions.rows(); ++v) {
    const auto rest = scene.garment.rest_positions.row(v);
    const Eigen::RowVector3f expected(1 - rest(1), 2 + rest(0), 3 + rest(2));
    EXPECT_LT((frame.coarse.positions.row(v) - expected).norm(), 1e-6f);
  }
  const Positions up = upsample(simulation.subdivision(), simulation.coarse().faces, frame.coarse.positions);
  EXPECT_LT((frame.fine->positions - up).rowwise().norm().maxCoeff(), 1e-6f);
}

TEST(Simulation, VelocitiesAreBackwardDifferences) {
  Simulation simulation(busy_scene(), Mode::kTrackedFine);
  SimulatedFrame last = simulation.next_frame();
  for (int k = 1; k < 5; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    EXPECT_DOUBLE_EQ(frame.coarse.time_s, 0.04 * k);
    const Positions expected = (frame.coarse.positions - last.coarse.positions) / 0.04f;
    EXPECT_LT((frame.coarse.velocities - expected).cwiseAbs().maxCoeff(), 1e-5f);
    const Positions fine = (frame.fine->positions - last.fine->positions) / 0.04f;
    EXPECT_LT((frame.fine->velocities - fine).cwiseAbs().maxCoeff(), 1e-5f);
    last = frame;
  }
}

TEST(Simulation, RerunsAreBitIdenticalForAnyNumberOfThreads) {
  Scene scene = busy_scene();
  Simulation one(scene, Mode::kTrackedFine), again(scene, Mode::kTrackedFine);
  scene.threads = 3;
  Simulation three(scene, Mode::kTrackedFine);
  std::uint64_t contacts = 0;
  for (int k = 0; k < 15; ++k) {
    const SimulatedFrame frame = one.next_frame();
    contacts += frame.report.contacts;
    expect_same(frame, again.next_frame());
    expect_same(frame, three.next_frame());
  }
  EXPECT_GT(contacts, 100u);
}

TEST(Simulation, SeedsMakeDifferentMotions) {
  Scene scene = busy_scene();
  Simulation a(scene, Mode::kCoarse);
  scene.seed = 8;
  Simulation b(scene, Mode::kCoarse);
  for (int k = 0; k < 12; ++k) {
    if (k < 11) {
      a.next_frame();
      b.next_frame();
    } else {
      EXPECT_GT((a.next_frame().coarse.positions - b.next_frame().coarse.positions).norm(), 1e-3f);
    }
  }
}

TEST(Simulation, ResumesBitIdenticallyFromEveryFrame) {
  for (const Mode mode : {Mode::kCoarse, Mode::kTrackedFine, Mode::kFreeFine}) {
    Simulation original(busy_scene(), mode);
    std::vector<SimulatedFrame> frames;
    std::vector<std::vector<std::byte>> checkpoints;
    for (int k = 0; k < 14; ++k) {
      frames.push_back(original.next_frame());
      checkpoints.push_back(original.checkpoint());
    }
    for (const int k : {0, 3, 9, 12}) {
      Simulation resumed(busy_scene(), mode);
      resumed.restore(checkpoints[static_cast<std::size_t>(k)]);
      EXPECT_EQ(resumed.next_index(), static_cast<std::uint64_t>(k) + 1);
      for (int j = k + 1; j < 14; ++j) expect_same(resumed.next_frame(), frames[static_cast<std::size_t>(j)]);
      // Also back in time, in a simulation that has gone on.
      resumed.restore(checkpoints[0]);
      expect_same(resumed.next_frame(), frames[1]);
    }
  }
}

TEST(Simulation, RefusesBadCheckpointsAndGoesOn) {
  Simulation simulation(busy_scene(), Mode::kCoarse), twin(busy_scene(), Mode::kCoarse);
  for (int k = 0; k < 3; ++k) {
    simulation.next_frame();
    twin.next_frame();
  }
  const auto good = simulation.checkpoint();
  const auto expect_refused = [&](const std::vector<std::byte>& bytes, ErrorCode code) {
    try {
      simulation.restore(bytes);
      FAIL();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code) << e.what();
      EXPECT_THAT(e.what(), HasSubstr("check-point"));
    }
  };
  expect_refused({}, ErrorCode::kDataLoss);
  for (const std::size_t size : {std::size_t{1}, std::size_t{20}, good.size() / 2, good.size() - 1}) {
    expect_refused({good.begin(), good.begin() + static_cast<std::ptrdiff_t>(size)}, ErrorCode::kDataLoss);
  }
  for (std::size_t at = 0; at < good.size(); at += 101) {
    auto bad = good;
    bad[at] ^= std::byte{0x10};
    EXPECT_THROW(simulation.restore(bad), Error);
  }
  Scene other = busy_scene();
  other.gravity.y() = -5;
  expect_refused(Simulation(other, Mode::kCoarse).checkpoint(), ErrorCode::kInvalidArgument);
  expect_refused(Simulation(busy_scene(), Mode::kFreeFine).checkpoint(), ErrorCode::kInvalidArgument);
  expect_same(simulation.next_frame(), twin.next_frame());
}

TEST(Simulation, EndsWithItsLastFrame) {
  Scene scene = sheet_scene(2);
  scene.frames = 2;
  Simulation simulation(scene, Mode::kCoarse);
  simulation.next_frame();
  simulation.next_frame();
  try {
    simulation.next_frame();
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kFailedPrecondition);
  }
}

TEST(Simulation, DivergenceIsAnErrorAndNotGarbage) {
  Scene scene = sheet_scene(2);
  scene.gravity.y() = -1e4;
  scene.frame_time_s = 10;  // it falls a thousand kilometres
  Simulation simulation(scene, Mode::kCoarse);
  simulation.next_frame();
  try {
    for (int k = 0; k < 5; ++k) simulation.next_frame();
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kFailedPrecondition);
    EXPECT_THAT(e.what(), HasSubstr("diverged"));
  }
}

TEST(Simulation, AStepThatIsTooLargeIsCutAndReported) {
  // A second a frame in one step, and a handle that jerks the corner away at 40 m/s.
  Scene scene = sheet_scene(3);
  scene.frame_time_s = 0.2;
  scene.steps_per_frame = 1;
  Handle handle = handle_on({0});
  handle.hard = true;
  handle.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.2, {0, 8, 0}, {0, 0, 0}}};
  scene.handles.push_back(handle);
  Simulation simulation(scene, Mode::kCoarse);
  simulation.next_frame();
  const SimulatedFrame frame = simulation.next_frame();
  EXPECT_GT(frame.report.cut_steps, 0u);
  EXPECT_TRUE(frame.coarse.positions.allFinite());
  EXPECT_NEAR(frame.coarse.positions(0, 1), 8, 0.1);
  EXPECT_LT(frame.coarse.positions.cwiseAbs().maxCoeff(), 20);
}

TEST(Simulation, TrackedFineFollowsTheCoarseMeshAndFreeFineDoesNot) {
  Scene scene = sheet_scene(6);
  scene.material = read_material("deploy/materials/gray-interlock.json");
  scene.perturbation_m = 2e-3;
  scene.handles.push_back(handle_on({0}));
  const auto distance = [&](Mode mode, const Tracking& tracking) {
    scene.tracking = tracking;
    Simulation simulation(scene, mode);
    SimulatedFrame frame;
    for (int k = 0; k < 25; ++k) frame = simulation.next_frame();
    double sum = 0;
    const auto& features = simulation.feature_vertices();
    for (std::size_t v = 0; v < features.size(); ++v) {
      sum += static_cast<double>(
          (frame.fine->positions.row(features[v]) - frame.coarse.positions.row(static_cast<Eigen::Index>(v)))
              .squaredNorm());
    }
    return std::sqrt(sum / static_cast<double>(features.size()));
  };
  const double springs = distance(Mode::kTrackedFine, published_tracking());
  const double tight = distance(Mode::kTrackedFine, {.frequency = 50});
  const double averages = distance(Mode::kTrackedFine, {});
  const double free = distance(Mode::kFreeFine, {});
  EXPECT_LT(springs, 5e-3);
  EXPECT_LT(tight, averages);
  EXPECT_LT(averages, free);
  EXPECT_GT(free, 3 * springs);
}

TEST(Simulation, HandlesHoldMoveAndRelease) {
  Scene scene = sheet_scene(4);
  scene.frames = 60;
  Handle handle;
  handle.vertices = {0, 1, 5};
  handle.hard = true;
  handle.end_s = 1;
  handle.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.8, {0, 0.3, 0}, {0, 0, 0}}};
  scene.handles.push_back(handle);
  Simulation simulation(scene, Mode::kCoarse);
  const Positions start = simulation.next_frame().coarse.positions;
  SimulatedFrame frame;
  for (int k = 1; k <= 20; ++k) frame = simulation.next_frame();
  for (const std::uint32_t v : handle.vertices) {
    EXPECT_LT((frame.coarse.positions.row(v) - start.row(v) - Eigen::RowVector3f(0, 0.3f, 0)).norm(), 1e-4f);
  }
  for (int k = 21; k <= 50; ++k) frame = simulation.next_frame();
  EXPECT_LT(frame.coarse.positions(0, 1), 0.0f);  // let go at 1 s, it falls
}

TEST(Simulation, WarnsOnceOfAHandleThatWouldTearTheCloth) {
  const auto warnings = [](double limit, double pull_m) {
    Scene scene = sheet_scene(4);
    scene.gravity.setZero();
    if (limit > 0) scene.handle_stretch_warning = limit;
    scene.handles = {handle_on({0, 5, 10, 15, 20}), handle_on({4, 9, 14, 19, 24}, 0, 0.5)};
    scene.handles[0].hard = scene.handles[1].hard = true;
    scene.handles[1].name = "right";
    scene.handles[1].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.4, {pull_m, 0, 0}, {0, 0, 0}}};
    Simulation simulation(scene, Mode::kCoarse);
    std::vector<std::string> all;
    for (int k = 0; k < 20; ++k) {
      const SimulatedFrame frame = simulation.next_frame();
      all.insert(all.end(), frame.warnings.begin(), frame.warnings.end());
    }
    return all;
  };
  EXPECT_TRUE(warnings(1.3, 0.1).empty());  // 1.2 times its length
  EXPECT_TRUE(warnings(0, 0.3).empty());    // the default allows twice
  const auto torn = warnings(1.3, 0.3);
  ASSERT_EQ(torn.size(), 1u);
  EXPECT_THAT(torn[0], HasSubstr("stretches the cloth to 1."));
  EXPECT_THAT(torn[0], HasSubstr("beyond 1.3"));
  EXPECT_THAT(torn[0], HasSubstr("handle"));
  EXPECT_THAT(warnings(0, 0.8).at(0), HasSubstr("beyond 2"));
}

TEST(Simulation, FreeFineClothMayStartFromLoopsSurface) {
  Scene scene = sheet_scene(4);
  // A ridge: Loop's rule rounds it, so that the fine mesh starts below its top.
  for (Eigen::Index v = 0; v < scene.garment.vertex_count(); ++v) {
    if (v % 5 == 2) scene.garment.rest_positions(v, 1) = 0.05f;
  }
  scene.subdivision_rule = SubdivisionRule::kLoop;
  Simulation simulation(scene, Mode::kFreeFine);
  const SimulatedFrame frame = simulation.next_frame();
  EXPECT_LT((frame.fine->positions - simulation.fine().rest_positions).cwiseAbs().maxCoeff(), 1e-6f);
  EXPECT_LT(frame.fine->positions.col(1).maxCoeff(), 0.045f);
  EXPECT_EQ(simulation.fine().uv, subdivide(scene.garment, 2).fine.uv);
  for (int k = 0; k < 3; ++k) EXPECT_TRUE(simulation.next_frame().fine->positions.allFinite());
  try {
    Simulation(scene, Mode::kTrackedFine);
    FAIL() << "a tracked simulation from another surface";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("Loop"));
  }
}

TEST(Simulation, LoopsSurfaceStartsUnstretched) {
  // An irregular flat mesh, in which Loop's rule slides vertices, and a curved one.
  for (const char* name : {"deploy/garments/tablecloth.obj", "deploy/garments/skirt.obj"}) {
    Scene scene = sheet_scene();
    scene.garment = read_obj(name);
    scene.subdivision_rule = SubdivisionRule::kLoop;
    const Simulation simulation(scene, Mode::kFreeFine);
    const Topology& fine = simulation.fine();
    for (Eigen::Index f = 0; f < fine.face_count(); ++f) {
      Eigen::Matrix3d corners;
      for (int k = 0; k < 3; ++k) corners.col(k) = fine.rest_positions.row(fine.faces(f, k)).cast<double>().transpose();
      const auto stretch = principal_stretches(shape_gradients(fine, f), corners).stretch;
      ASSERT_LT(stretch[0], 1.01) << name << " face " << f;
      ASSERT_GT(stretch[1], 0.99) << name << " face " << f;
    }
  }
}

TEST(Simulation, SoftHandlesSagByLoadOverStiffness) {
  Scene scene = sheet_scene(4);
  scene.damping_s = 0.01;
  scene.material = plain_material(400, 1e-4);
  scene.transform.rotation = {1.5707963267948966, 0, 0};
  Handle handle;
  for (std::uint32_t i = 0; i < 5; ++i) handle.vertices.push_back(i);
  handle.stiffness = 50;
  scene.handles.push_back(handle);
  Simulation simulation(scene, Mode::kCoarse);
  const Positions start = simulation.next_frame().coarse.positions;
  SimulatedFrame frame;
  for (int k = 0; k < 120; ++k) frame = simulation.next_frame();
  double sag = 0;
  for (int i = 0; i < 5; ++i) sag += static_cast<double>(start(i, 1) - frame.coarse.positions(i, 1)) / 5;
  EXPECT_NEAR(sag, 0.25 * 0.2 * 9.81 / (5 * 50), 2e-5);
}

TEST(Simulation, ScaleScalesTheClothAndItsMaterialCoordinates) {
  Scene scene = sheet_scene(2);
  scene.transform.scale = 2;
  const Simulation simulation(scene, Mode::kCoarse);
  EXPECT_FLOAT_EQ(simulation.coarse().rest_positions.col(0).maxCoeff(), 0.5f);
  EXPECT_FLOAT_EQ(simulation.coarse().uv.col(0).maxCoeff(), 0.5f);
}

TEST(Simulation, ObstacleFramesFollowTheScript) {
  const Scene scene = busy_scene();
  EXPECT_EQ(obstacle_frames(scene, 0).at(0).center, Eigen::Vector3f(0, -0.12f, 0));
  EXPECT_LT((obstacle_frames(scene, 1).at(0).center - Eigen::Vector3f(0, -0.12f, 0.3f)).norm(), 1e-6f);
  EXPECT_EQ(obstacle_frames(scene, 0).at(0).name, "ball");
}

TEST(Simulation, StopsWithinAStepWhenAsked) {
  Simulation simulation(busy_scene(), Mode::kTrackedFine);
  simulation.next_frame();
  int asked = 0;
  simulation.stop_when([&] { return ++asked > 3; });
  try {
    simulation.next_frame();
    FAIL() << "not stopped";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kCancelled);
  }
  EXPECT_EQ(asked, 4);
}

TEST(Simulation, RefusesWhatNoClothMeets) {
  const auto refused = [](const auto& change, const std::string& what) {
    Scene scene = busy_scene();
    change(scene);
    try {
      Simulation(scene, Mode::kCoarse);
      ADD_FAILURE() << what << " was accepted";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
      EXPECT_NE(std::string(e.what()).find(what), std::string::npos) << e.what();
    }
  };
  refused([](Scene& s) { s.gravity = {0, -1e12, 0}; }, "gravity is 1e+12 m/s2");
  refused([](Scene& s) { s.material.density = 1e-12; }, "density is 1e-12 kg/m2");
  refused([](Scene& s) { s.transform.translation.x() = 1e6; }, "initial translation");
  refused([](Scene& s) { s.velocity.x() = 1e7; }, "initial velocity");
  refused(
      [](Scene& s) {
        s.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {1, {0, 1e30, 0}, {0, 0, 0}}};
      },
      "key frame 1: translation");
}

}  // namespace
}  // namespace pleat::simulation
