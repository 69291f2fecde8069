#include "common/scene/animation_parts.hpp"

#include <gtest/gtest.h>

#include "common/base/error.hpp"

namespace pleat {
namespace {

void animate(v1::Obstacle& obstacle, std::size_t samples) {
  const std::size_t values = samples * 3 * animated_points(obstacle);
  for (std::size_t i = 0; i < values; ++i) obstacle.mutable_animation()->add_positions(static_cast<float>(i));
}

/// A mesh of 700 vertices, two capsules and a sphere, all animated.
v1::Scene scene(std::size_t samples) {
  v1::Scene scene;
  v1::Obstacle& body = *scene.add_obstacles();
  body.set_name("body");
  for (int i = 0; i < 3 * 700; ++i) body.mutable_mesh()->add_rest_positions(0);
  v1::Obstacle& limbs = *scene.add_obstacles();
  limbs.set_name("limbs");
  limbs.mutable_capsules()->add_capsules();
  limbs.mutable_capsules()->add_capsules();
  v1::Obstacle& ball = *scene.add_obstacles();
  ball.set_name("ball");
  ball.mutable_sphere()->set_radius(1);
  for (v1::Obstacle& obstacle : *scene.mutable_obstacles()) animate(obstacle, samples);
  return scene;
}

template <typename Action>
void expect_refused(ErrorCode code, const std::string& text, const Action& action) {
  try {
    action();
    FAIL() << "expected: " << text;
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), code) << error.what();
    EXPECT_NE(std::string(error.what()).find(text), std::string::npos) << error.what();
  }
}

TEST(AnimationParts, TakenApartAndPutTogetherTheSceneIsTheSame) {
  const v1::Scene whole = scene(1100);
  v1::Scene announced = whole;
  const auto parts = take_animations(announced, 1000);
  for (const v1::Obstacle& obstacle : announced.obstacles()) {
    EXPECT_EQ(obstacle.animation().samples(), 1100u);
    EXPECT_TRUE(obstacle.animation().positions().empty());
  }
  ASSERT_GE(parts.size(), 5u);  // 2.3 million values of the mesh in three parts
  for (const v1::AnimationPart& part : parts) EXPECT_LE(part.positions_size(), 1 << 20);

  AnimationAssembly assembly(announced, "scene");
  for (const v1::AnimationPart& part : parts) {
    EXPECT_FALSE(assembly.complete());
    EXPECT_FALSE(assembly.describe_missing().empty());
    assembly.add(part);
  }
  EXPECT_TRUE(assembly.complete());
  EXPECT_EQ(announced.SerializeAsString(), whole.SerializeAsString());
}

TEST(AnimationParts, ASmallSceneStaysWhole) {
  v1::Scene small = scene(3);
  EXPECT_TRUE(take_animations(small).empty());
  EXPECT_EQ(small.SerializeAsString(), scene(3).SerializeAsString());
  EXPECT_TRUE(AnimationAssembly(small, "scene").complete());
}

TEST(AnimationParts, NoWholeSampleIsLeftForTheReceiverToRefuse) {
  v1::Scene odd = scene(4);
  odd.mutable_obstacles(2)->mutable_animation()->add_positions(1);
  take_animations(odd, 0);
  EXPECT_EQ(odd.obstacles(2).animation().positions_size(), 13);
}

TEST(AnimationParts, WrongPartsAreRefused) {
  v1::Scene announced = scene(4);
  const auto parts = take_animations(announced, 0);
  AnimationAssembly assembly(announced, "scene");
  const auto with = [&](auto change) {
    v1::AnimationPart part = parts[1];
    change(part);
    return [&assembly, part] { assembly.add(part); };
  };
  using enum ErrorCode;
  expect_refused(kInvalidArgument, "'hat': no part of it is missing", with([](auto& p) { p.set_obstacle("hat"); }));
  expect_refused(kInvalidArgument, "multiple of 12", with([](auto& p) { p.add_positions(0); }));
  expect_refused(kInvalidArgument, "multiple of 12", with([](auto& p) { p.clear_positions(); }));
  expect_refused(kInvalidArgument, "more than the 4 samples", with([](auto& p) {
                   for (int i = 0; i < 12; ++i) p.add_positions(0);
                 }));
  assembly.add(parts[1]);
  expect_refused(kInvalidArgument, "'limbs': no part of it is missing", with([](auto&) {}));
  EXPECT_EQ(assembly.describe_missing(), "obstacle 'ball' misses 4 samples of its animation");
}

TEST(AnimationParts, WrongAnnouncementsAreRefused) {
  const auto refuse = [](ErrorCode code, const std::string& text, auto change) {
    v1::Scene announced = scene(4);
    take_animations(announced, 0);
    change(announced);
    expect_refused(code, text, [&] { AnimationAssembly(announced, "scene"); });
  };
  using enum ErrorCode;
  refuse(kInvalidArgument, "scene.obstacles[1].animation.samples: there are positions",
         [](v1::Scene& s) { s.mutable_obstacles(1)->mutable_animation()->add_positions(0); });
  refuse(kInvalidArgument, "another obstacle is named 'body'",
         [](v1::Scene& s) { s.mutable_obstacles(1)->set_name("body"); });
  refuse(kInvalidArgument, "no points",
         [](v1::Scene& s) { s.mutable_obstacles(0)->mutable_mesh()->clear_rest_positions(); });
  refuse(kResourceExhausted, "at most 1024",
         [](v1::Scene& s) { s.mutable_obstacles(0)->mutable_animation()->set_samples(200'000); });
}

}  // namespace
}  // namespace pleat
