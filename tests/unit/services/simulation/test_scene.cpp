#include "services/simulation/scene.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "common/base/error.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

void expect_refused(const std::function<void(Scene&)>& spoil, const std::string& culprit) {
  Scene scene = sheet_scene();
  spoil(scene);
  try {
    validate_scene(scene);
    FAIL() << "accepted: " << culprit;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("test"));
    EXPECT_THAT(e.what(), HasSubstr(culprit));
  }
}

Obstacle ball() {
  Obstacle o;
  o.name = "ball";
  o.radius = 0.1;
  o.center = {0, -1, 0};
  return o;
}

TEST(Scene, DefaultsAreValid) {
  EXPECT_NO_THROW(validate_scene(sheet_scene()));
  Scene scene = sheet_scene();
  scene.handles.push_back(handle_on({0, 1}));
  scene.obstacles.push_back(ball());
  EXPECT_NO_THROW(validate_scene(scene));
}

TEST(Scene, RefusesBadNumbers) {
  expect_refused([](Scene& s) { s.steps_per_frame = 0; }, "steps per frame");
  expect_refused([](Scene& s) { s.steps_per_frame = -3; }, "steps per frame");
  expect_refused([](Scene& s) { s.frames = 0; }, "frames");
  expect_refused([](Scene& s) { s.frame_time_s = 0; }, "frame time");
  expect_refused([](Scene& s) { s.frame_time_s = kNaN; }, "frame time");
  expect_refused([](Scene& s) { s.gravity.y() = kNaN; }, "gravity");
  expect_refused([](Scene& s) { s.density_multiplier = -1; }, "density");
  expect_refused([](Scene& s) { s.material.density = 0; }, "density");
  expect_refused([](Scene& s) { s.stretching_multiplier = 0; }, "stretching");
  expect_refused([](Scene& s) { s.bending_multiplier = -1; }, "bending");
  expect_refused([](Scene& s) { s.damping_s = -1; }, "damping");
  expect_refused([](Scene& s) { s.strain_limits.minimum = 1.1; }, "strain limits");
  expect_refused([](Scene& s) { s.strain_limits.minimum = -0.1; }, "strain limits");
  expect_refused([](Scene& s) { s.strain_limits.maximum = 0.9; }, "strain limits");
  expect_refused([](Scene& s) { s.strain_limits.maximum = kNaN; }, "strain limits");
  expect_refused([](Scene& s) { s.wind.density = -1; }, "wind");
  expect_refused([](Scene& s) { s.wind.velocity.x() = kNaN; }, "wind");
  expect_refused([](Scene& s) { s.contact.thickness = 0; }, "thickness");
  expect_refused([](Scene& s) { s.contact.friction = -0.1; }, "friction");
  expect_refused([](Scene& s) { s.subdivision_rounds = 6; }, "subdivision");
  expect_refused([](Scene& s) { s.tracking.spring = -1; }, "tracking");
  expect_refused([](Scene& s) { s.tracking.frequency = -1; }, "tracking: frequency");
  expect_refused([](Scene& s) { s.tracking.frequency = kNaN; }, "tracking: frequency");
  expect_refused([](Scene& s) { s.tracking.frequency = 1001; }, "tracking: frequency is 1001 rad/s");
  expect_refused([](Scene& s) { s.transform.scale = 0; }, "scale");
  expect_refused([](Scene& s) { s.threads = -1; }, "threads");
  expect_refused([](Scene& s) { s.handle_stretch_warning = 0.5; }, "handle stretch warning");
}

TEST(Scene, RefusesBadGarments) {
  expect_refused([](Scene& s) { s.garment.rest_positions(3, 0) = std::numeric_limits<float>::infinity(); }, "vertex 3");
  expect_refused([](Scene& s) { s.garment.uv.resize(0, 2), s.garment.uv_faces.resize(0, 3); }, "material coordinates");
}

TEST(Scene, RefusesLayersThatAreNotTheGarments) {
  const auto with = [](const std::vector<GarmentLayer>& layers, const std::string& culprit) {
    expect_refused(
        [&](Scene& scene) {
          scene.garment = sheet(2, 2, 1, 1);  // 8 faces that hang together
          scene.layers = layers;
        },
        culprit);
  };
  with({{"shirt", 7}}, "the layers have 7 of the garment's 8 faces");
  with({{"shirt", 4}, {"coat", 4}}, "layers 'shirt' and 'coat' share vertex");
  with({{"shirt", 8}, {"coat", 1}}, "layer 'coat' has 1 of the 0 faces");
  with({{"shirt", 0}, {"coat", 8}}, "layer 'shirt' has 0");
  Scene one = sheet_scene(2);
  one.layers = {{"shirt", 8}};
  EXPECT_NO_THROW(validate_scene(one));
}

TEST(Scene, RefusesBadHandles) {
  expect_refused([](Scene& s) { s.handles.push_back(handle_on({81})); }, "vertex 81");
  expect_refused([](Scene& s) { s.handles.push_back({}); }, "no vertices");
  expect_refused([](Scene& s) { s.handles.push_back(handle_on({1}, 2, 1)); }, "ends before");
  expect_refused([](Scene& s) { s.handles.push_back(handle_on({1})), s.handles[0].stiffness = 0; }, "stiffness");
  expect_refused(
      [](Scene& s) {
        s.handles.push_back(handle_on({1, 2}));
        s.handles.push_back(handle_on({2, 3}));
      },
      "vertex 2");
  expect_refused([](Scene& s) { s.handles.push_back(handle_on({1})), s.handles[0].motion.keys.assign(2, KeyFrame{}); },
                 "ascend");
  expect_refused(
      [](Scene& s) {
        s.handles.push_back(handle_on({1})), s.handles[0].motion.keys.assign(1, {0, {0, kNaN, 0}, {0, 0, 0}});
      },
      "translation");
  // One after the other is fine.
  Scene scene = sheet_scene();
  scene.handles.push_back(handle_on({1}, 0, 1));
  scene.handles.push_back(handle_on({1}, 1));
  EXPECT_NO_THROW(validate_scene(scene));
}

TEST(Scene, RefusesBadObstacles) {
  const auto with = [](const std::function<void(Obstacle&)>& spoil) {
    return [spoil](Scene& s) {
      s.obstacles.push_back(ball());
      spoil(s.obstacles.back());
    };
  };
  expect_refused(with([](Obstacle& o) { o.name.clear(); }), "no name");
  expect_refused(with([](Obstacle& o) { o.radius = 0; }), "neither");
  expect_refused(with([](Obstacle& o) { o.radius = -1; }), "radius");
  expect_refused(with([](Obstacle& o) { o.center.z() = kNaN; }), "centre");
  expect_refused(with([](Obstacle& o) { o.mesh = sheet(1, 1, 1, 1); }), "a radius and a mesh");
  expect_refused(with([](Obstacle& o) { o.radius = 0, o.mesh = sheet(1, 1, 1, 1); }), "not closed");
  expect_refused([](Scene& s) { s.obstacles = {ball(), ball()}; }, "twice");
  expect_refused(with([](Obstacle& o) { o.capsules.resize(1); }), "a radius and capsules");
  const auto with_capsule = [](const Capsule& capsule) {
    return [capsule](Scene& s) {
      s.obstacles.push_back(ball());
      s.obstacles.back().radius = 0;
      s.obstacles.back().capsules = {{{0, 0, 0}, {0, 1, 0}, 0.1}, capsule};
    };
  };
  expect_refused(with_capsule({{0, 0, 0}, {0, 1, 0}, 0}), "capsule 1 needs a positive radius");
  expect_refused(with_capsule({{0, 0, 0}, {0, 1, 0}, kNaN}), "capsule 1 needs a positive radius");
  expect_refused(with_capsule({{0, kNaN, 0}, {0, 1, 0}, 1}), "capsule 1 has an end that is not finite");
}

TEST(Scene, RefusesBadAnimations) {
  const auto with = [](const std::function<void(Obstacle&)>& spoil) {
    return [spoil](Scene& s) {
      Obstacle o = ball();
      o.animation.samples.assign(3, Positions::Zero(1, 3));
      spoil(o);
      s.obstacles = {o};
    };
  };
  Scene scene = sheet_scene();
  with([](Obstacle&) {})(scene);
  EXPECT_NO_THROW(validate_scene(scene));
  expect_refused(with([](Obstacle& o) { o.animation.samples[2](0, 1) = std::nanf(""); }),
                 "obstacle 'ball': sample 2 of the animation is not finite at point 0");
  expect_refused(with([](Obstacle& o) { o.animation.samples[0](0, 2) = -1e30f; }), "sample 0 of the animation is more");
  expect_refused(with([](Obstacle& o) { o.animation.samples[1].resize(2, 3); }), "2 points instead of 1");
  expect_refused(with([](Obstacle& o) { o.animation.sample_time_s = 0; }), "time between");
  expect_refused(with([](Obstacle& o) { o.motion.keys.resize(1); }), "key frames and an animation");
}

TEST(Motion, PassesThroughItsKeysSmoothly) {
  Motion motion;
  motion.keys = {{1, {0, 0, 0}, {0, 0, 0}}, {2, {1, 0, 0}, {0, 1, 0}}, {4, {1, 2, 0}, {0, 2, 0}}};
  const Vector3d pivot(5, 0, 0);
  for (const KeyFrame& key : motion.keys) {
    const Pose pose = pose_at(motion, pivot, key.time_s);
    EXPECT_LT((pose.apply(pivot) - pivot - key.translation).norm(), 1e-12);
    EXPECT_LT((pose.rotation - rotation_matrix(key.rotation)).norm(), 1e-12);
  }
  EXPECT_LT((pose_at(motion, pivot, -5).apply(pivot) - pivot).norm(), 1e-12);
  EXPECT_LT((pose_at(motion, pivot, 99).apply(pivot) - pivot - Vector3d(1, 2, 0)).norm(), 1e-12);
  // No jumps of position or velocity.
  Vector3d last_step = Vector3d::Zero();
  for (double t = 0; t < 5; t += 1e-3) {
    const Vector3d step = pose_at(motion, pivot, t + 1e-3).apply(pivot) - pose_at(motion, pivot, t).apply(pivot);
    EXPECT_LT((step - last_step).norm(), 2e-5) << t;
    last_step = step;
  }
  EXPECT_EQ(pose_at({}, pivot, 3).rotation, Eigen::Matrix3d::Identity());
}

}  // namespace
}  // namespace pleat::simulation
