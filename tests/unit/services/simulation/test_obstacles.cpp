#include "services/simulation/obstacles.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/triangle_intersection.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

// Distance of a segment from a triangle, from its definition.
double segment_face_distance(const Vector3d& p, const Vector3d& q, const std::array<Vector3d, 3>& t) {
  const Triangle3f floats{t[0].cast<float>(), t[1].cast<float>(), t[2].cast<float>()};
  if (segment_intersects_triangle(p.cast<float>(), q.cast<float>(), floats)) return 0;
  double best = std::min(closest_vertex_face(p, t[0], t[1], t[2]).squared_distance,
                         closest_vertex_face(q, t[0], t[1], t[2]).squared_distance);
  for (std::size_t k = 0; k < 3; ++k) {
    best = std::min(best, closest_edge_edge(p, q, t[k], t[(k + 1) % 3]).squared_distance);
  }
  return std::sqrt(best);
}

// The smallest distance of the cloth from the surfaces of the capsules in a frame.
double clearance(const ObstacleFrame& capsules, const Positions& x, const Faces& faces) {
  double least = 1e30;
  for (Eigen::Index c = 0; c < static_cast<Eigen::Index>(capsules.capsule_radii.size()); ++c) {
    const Vector3d a = capsules.capsule_ends.row(2 * c).cast<double>().transpose();
    const Vector3d b = capsules.capsule_ends.row(2 * c + 1).cast<double>().transpose();
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      std::array<Vector3d, 3> corners;
      for (int k = 0; k < 3; ++k) {
        corners[static_cast<std::size_t>(k)] = x.row(faces(f, k)).cast<double>().transpose();
      }
      least = std::min(least, segment_face_distance(a, b, corners) -
                                  static_cast<double>(capsules.capsule_radii[static_cast<std::size_t>(c)]));
    }
  }
  return least;
}

Obstacle capsule_set(std::vector<Capsule> capsules) {
  Obstacle o;
  o.name = "limbs";
  o.capsules = std::move(capsules);
  return o;
}

struct Outcome {
  double least_clearance = 1e30;
  std::uint64_t contacts = 0, impacts = 0;
  Positions last;
};

Outcome run(const Scene& scene, int frames, Mode mode = Mode::kCoarse) {
  Simulation simulation(scene, mode);
  Outcome outcome;
  for (int k = 0; k < frames; ++k) {
    const SimulatedFrame frame = simulation.next_frame();
    for (const ObstacleFrame& o : frame.obstacles) {
      outcome.least_clearance =
          std::min(outcome.least_clearance, clearance(o, frame.coarse.positions, simulation.coarse().faces));
      if (frame.fine) {
        outcome.least_clearance =
            std::min(outcome.least_clearance, clearance(o, frame.fine->positions, simulation.fine().faces));
      }
    }
    outcome.contacts += frame.report.contacts;
    outcome.impacts += frame.report.impacts;
    outcome.last = frame.coarse.positions;
  }
  return outcome;
}

TEST(Obstacles, ClothHangsOverACapsule) {
  // Its axis runs below a row of vertices, along edges of the mesh: no edge crosses it in between its ends.
  Scene scene = sheet_scene(8);
  scene.obstacles.push_back(capsule_set({{{-0.4, -0.06, 0}, {0.4, -0.06, 0}, 0.04}}));
  const Outcome outcome = run(scene, 40);
  EXPECT_GT(outcome.contacts, 100u);
  EXPECT_GT(outcome.least_clearance, 0);
  EXPECT_GT(outcome.last.col(1).maxCoeff(), -0.03f);
  EXPECT_LT(outcome.last.col(1).minCoeff(), -0.15f);
}

TEST(Obstacles, TrackedFineClothStaysOutOfSeveralCapsules) {
  Scene scene = sheet_scene(4);
  scene.perturbation_m = 2e-3;
  scene.obstacles.push_back(capsule_set({{{-0.2, -0.08, -0.1}, {0.1, -0.05, 0.1}, 0.03},
                                         {{0.1, -0.05, 0.1}, {0.2, -0.2, -0.1}, 0.02},
                                         {{0, -0.2, 0}, {0, -0.2, 0}, 0.05}}));  // the last is a ball
  const Outcome outcome = run(scene, 15, Mode::kTrackedFine);
  EXPECT_GT(outcome.contacts, 100u);
  EXPECT_GT(outcome.least_clearance, 0);
}

TEST(Obstacles, AThinCapsuleDoesNotPassThroughTheClothSideways) {
  // 10 m/s and 5 mm thick: 50 mm a step.
  Scene scene = sheet_scene(6);
  scene.gravity.setZero();
  scene.obstacles.push_back(capsule_set({{{-0.3, -0.4, 0.013}, {0.25, -0.4, 0.021}, 0.005}}));
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.1, {0, 1, 0}, {0, 0, 0.4}}};
  const Outcome outcome = run(scene, 6);
  EXPECT_GT(outcome.impacts, 0u);
  EXPECT_GT(outcome.least_clearance, 0);
  EXPECT_GT(outcome.last.col(1).maxCoeff(), 0.4f);  // taken along
}

TEST(Obstacles, FrictionHoldsTheClothOnASlopingCapsule) {
  // A capsule as thick as a hill, along which the cloth would slide.
  const auto slide = [](double friction) {
    Scene scene = sheet_scene(6);
    scene.transform.rotation = {0, 0, -0.35};
    scene.contact.obstacle_friction = friction;
    const Vector3d along(std::cos(0.35), -std::sin(0.35), 0), up(std::sin(0.35), std::cos(0.35), 0);
    scene.obstacles.push_back(capsule_set({{-3 * along - 1.01 * up, 3 * along - 1.01 * up, 1}}));
    return run(scene, 15).last.col(0).mean();
  };
  const float rough = slide(0.8), smooth = slide(0);
  EXPECT_GT(smooth, rough + 0.1f);
}

TEST(Obstacles, PointsFollowTheKeyFramesRigidly) {
  Obstacle o = capsule_set({{{0, 0, 0}, {1, 0, 0}, 0.1}, {{1, 0, 0}, {1, 1, 0}, 0.05}});
  o.center = {0, 5, 0};
  o.motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {1, {0, 0, 2}, {0, 0, 1.5707963267948966}}};
  const auto points = points_at(o, 1);
  ASSERT_EQ(points.size(), 4u);
  const Vector3d pivot(0.75, 5.25, 0);  // a quarter turn about it, then up
  EXPECT_LT((points[0] - (pivot + Vector3d(0.25, -0.75, 2))).norm(), 1e-12);
  EXPECT_LT((points[3] - (pivot + Vector3d(-0.75, 0.25, 2))).norm(), 1e-12);
  const ObstacleFrame frame = frame_of(o, points);
  EXPECT_EQ(frame.capsule_radii, (std::vector<float>{0.1f, 0.05f}));
  EXPECT_EQ(frame.capsule_ends.rows(), 4);
  EXPECT_EQ(shape_of(o).capsules, 2u);
  EXPECT_EQ(shape_of(o).faces.rows(), 0);
}

TEST(Obstacles, AnimationsAreLinearBetweenSamples) {
  Obstacle ball;
  ball.name = "ball";
  ball.radius = 0.1;
  for (const float y : {1.0f, 2.0f, 4.0f}) {
    Positions sample(1, 3);
    sample << 0, y, 0;
    ball.animation.samples.push_back(sample);
  }
  ball.animation.sample_time_s = 0.5;
  const auto height = [&](double time) { return points_at(ball, time)[0].y(); };
  EXPECT_DOUBLE_EQ(height(-1), 1);
  EXPECT_DOUBLE_EQ(height(0.25), 1.5);
  EXPECT_DOUBLE_EQ(height(0.5), 2);
  EXPECT_DOUBLE_EQ(height(0.9), 3.6);
  EXPECT_DOUBLE_EQ(height(7), 4);
}

TEST(Obstacles, AnAnimatedMeshMovesTheClothAsItsKeyFramesWould) {
  Scene scene = sheet_scene(5);
  scene.perturbation_m = 1e-3;
  Obstacle box;
  box.name = "box";
  box.mesh = box_mesh(0.2);
  box.center = {0, -0.13, 0};
  scene.obstacles = {box};
  // Straight motion at a constant speed can be said both ways, but key frames start smoothly: so the animation has the
  // samples of the key frames at every step.
  scene.obstacles[0].motion.keys = {{0, {0, 0, 0}, {0, 0, 0}}, {0.3, {0, 0.2, 0}, {0, 0.5, 0}}};
  Scene animated = scene;
  animated.obstacles[0].motion.keys.clear();
  Animation& animation = animated.obstacles[0].animation;
  animation.sample_time_s = 0.005;
  for (int k = 0; k <= 80; ++k) {
    animation.samples.push_back(obstacle_frames(scene, 0.005 * k).at(0).positions);
  }
  Simulation a(scene, Mode::kCoarse), b(animated, Mode::kCoarse);
  std::uint64_t contacts = 0;
  for (int k = 0; k < 8; ++k) {
    const SimulatedFrame one = a.next_frame(), other = b.next_frame();
    contacts += other.report.contacts;
    EXPECT_LT((one.obstacles[0].positions - other.obstacles[0].positions).norm(), 1e-5f);
    EXPECT_LT((one.coarse.positions - other.coarse.positions).norm(), 1e-2f);
  }
  EXPECT_GT(contacts, 10u);
}

TEST(Obstacles, CapsulesAndAnimationsResumeBitIdentically) {
  Scene scene = sheet_scene(4);
  scene.obstacles.push_back(capsule_set({{{-0.2, -0.05, 0}, {0.2, -0.05, 0.05}, 0.03}}));
  for (int k = 0; k < 5; ++k) {
    Positions sample(2, 3);
    sample << -0.2f, -0.05f + 0.01f * static_cast<float>(k), 0, 0.2f, -0.05f, 0.05f;
    scene.obstacles[0].animation.samples.push_back(sample);
  }
  Simulation original(scene, Mode::kCoarse);
  for (int k = 0; k < 6; ++k) original.next_frame();
  const auto checkpoint = original.checkpoint();
  Simulation resumed(scene, Mode::kCoarse);
  resumed.restore(checkpoint);
  for (int k = 0; k < 4; ++k) {
    const SimulatedFrame one = original.next_frame(), other = resumed.next_frame();
    EXPECT_EQ(one.coarse.positions, other.coarse.positions);
    EXPECT_EQ(one.obstacles[0].capsule_ends, other.obstacles[0].capsule_ends);
  }
  scene.obstacles[0].animation.samples[4](0, 0) -= 0.1f;
  try {
    Simulation(scene, Mode::kCoarse).restore(checkpoint);
    FAIL() << "the check-point of another animation";
  } catch (const Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("another scene"));
  }
}

std::string refusal(const Scene& scene) {
  try {
    Simulation simulation(scene, Mode::kCoarse);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    return e.what();
  }
  return "accepted";
}

TEST(Obstacles, AStartInsideACapsuleIsRefused) {
  Scene scene = sheet_scene(4);
  const auto with = [&](const Capsule& capsule) {
    scene.obstacles = {capsule_set({capsule})};
    return refusal(scene);
  };
  EXPECT_THAT(with({{-0.1, 0, 0}, {0.1, 0.01, 0}, 0.05}), HasSubstr("'limbs'"));
  EXPECT_THAT(with({{0, -9, 0}, {0, 9, 0}, 5}), HasSubstr("'limbs'"));  // deep inside
  // Thin, through the middle of a face: neither its ends nor the face's edges are near.
  EXPECT_THAT(with({{0.1, -1, 0.02}, {0.1, 1, 0.02}, 1e-4}), HasSubstr("cuts obstacle 'limbs'"));
  EXPECT_EQ(with({{-0.1, -0.2, 0}, {0.1, -0.2, 0}, 0.05}), "accepted");
}

TEST(Obstacles, AnUncleanStartNamesSeveralPlaces) {
  Scene scene = sheet_scene(4);
  Obstacle ball;
  ball.name = "ball";
  ball.radius = 0.05;
  scene.obstacles = {capsule_set({{{-0.2, 0, 0.1}, {0.2, 0, 0.1}, 0.01}}), ball};
  const std::string message = refusal(scene);
  EXPECT_THAT(message, HasSubstr("'limbs'"));
  EXPECT_THAT(message, HasSubstr("'ball'"));
  EXPECT_THAT(message, HasSubstr("more places"));
}

}  // namespace
}  // namespace pleat::simulation
