// Variations of one's own scenes.
#include "services/dataset/scene_set.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "common/store/dataset.hpp"
#include "services/simulation/simulation.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/dataset/small_set.hpp"

namespace pleat::dataset {
namespace {

using nlohmann::json;
using test::error_of;
using testing::HasSubstr;

class SceneSet : public SmallSet {
 protected:
  SceneSet() {
    options.scenes.set = kOwnScenes;
    options.scenes.frames = 0;
    options.scenes.sequences = 7;
    options.scenes.material.clear();
    scene_ = {{"name", "hung"},
              {"garmentFile", "cloth.obj"},
              {"materialFile", std::filesystem::absolute(material_).string()},
              {"placement", {{"axis", {1, 0, 0}}, {"angleDeg", 90}, {"translation", {0, 1, 0}}}},
              {"frames", 4},
              {"stepsPerFrame", 4},
              {"handles",
               {{{"vertices", {28}}, {"motion", {{{"timeS", 0.1}}, {{"timeS", 0.4}, {"translation", {-0.1, 0, 0}}}}}},
                {{"vertices", {34}}, {"endS", 0.5}}}},
              {"wind", {{"velocity", {2, 0, 0}}}},
              {"obstacles",
               {{{"name", "ball"},
                 {"sphere", {{"center", {0.15, 0.9, 0.3}}, {"radius", 0.1}}},
                 {"motion", {{{"timeS", 0.0}}, {{"timeS", 0.5}, {"translation", {0, 0, -0.2}}}}}}}}};
  }

  void write(const json& scene, const std::string& name = "hung.json") {
    std::ofstream(root / name) << scene.dump();
    options.scenes.own_scenes = {root / name};
  }

  const std::filesystem::path material_ = options.scenes.material;
  json scene_;
};

TEST_F(SceneSet, TheScenesSayHowTheFineClothFollows) {
  write(scene_);
  options.scenes.frequency = 20;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_EQ(plan.scene.tracking.frequency, 20);
    EXPECT_EQ(json::parse(plan.scene_json)["tracking"]["frequency"], 20) << plan.scene_json;
  }
  options.scenes.frequency = 0;
  options.scenes.springs = true;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_EQ(plan.scene.tracking.spring, simulation::published_tracking().spring);
    EXPECT_EQ(json::parse(plan.scene_json)["tracking"]["spring"], plan.scene.tracking.spring) << plan.scene_json;
  }
}

TEST_F(SceneSet, TheSceneItselfIsForTestingAndEverySixthVariation) {
  write(scene_);
  const auto plans = plan_sequences(options.scenes);
  ASSERT_EQ(plans.size(), 8U);
  EXPECT_EQ(plans[0].name, "hung");
  EXPECT_EQ(plans[0].scene.steps_per_frame, 4);
  EXPECT_EQ(plans[0].scene.bending_multiplier, 1);
  std::string splits;
  for (const SequencePlan& plan : plans) splits += plan.split == "test" ? 'T' : '-';
  EXPECT_EQ(splits, "T-----T-");
  options.scenes.sequences = 2;
  EXPECT_EQ(plan_sequences(options.scenes)[2].split, "test");
}

TEST_F(SceneSet, VariationsKeepWhatTheSceneIsMadeOf) {
  write(scene_);
  options.scenes.sequences = 24;
  const auto plans = plan_sequences(options.scenes);
  const simulation::Scene& original = plans[0].scene;
  std::set<std::string> scenes;
  std::set<int> steps;
  for (const SequencePlan& plan : plans) {
    const simulation::Scene& scene = plan.scene;
    scenes.insert(plan.scene_json);
    steps.insert(scene.steps_per_frame);
    EXPECT_EQ(topology_hash(scene.garment), topology_hash(original.garment));
    EXPECT_EQ(scene.frames, 4);
    EXPECT_EQ(scene.handles[0].vertices, original.handles[0].vertices);
    EXPECT_EQ(scene.obstacles[0].radius, 0.1);
    // All times go at one pace.
    const double pace = scene.handles[0].motion.keys[1].time_s / 0.4;
    EXPECT_GE(pace, 0.8);
    EXPECT_LE(pace, 1.25);
    EXPECT_NEAR(scene.handles[1].end_s, pace * 0.5, 1e-12);
    EXPECT_NEAR(scene.obstacles[0].motion.keys[1].time_s, pace * 0.5, 1e-12);
    // Handles that move apart don't go further than they did.
    const double reach = scene.handles[0].motion.keys[1].translation.x() / -0.1;
    EXPECT_GE(reach, 0.7 / 1.000001);
    EXPECT_LE(reach, 1);
    const double wind = scene.wind.velocity.norm() / 2;
    EXPECT_GE(wind, 0.5);
    EXPECT_LE(wind, 1.5);
    EXPECT_GE(scene.bending_multiplier, 0.62);
    EXPECT_LE(scene.bending_multiplier, 1.61);
    EXPECT_GE(scene.damping_s, 0);
    EXPECT_LE(scene.damping_s, 0.005);
    EXPECT_NEAR(scene.contact.friction / 0.6, scene.contact.obstacle_friction / 0.3, 1e-12);
    // The record says what was simulated.
    const json record = json::parse(plan.scene_json);
    EXPECT_EQ(record.value("steps_per_frame", 0), scene.steps_per_frame);
    EXPECT_DOUBLE_EQ(record.value("material_options", json::object()).value("bending_scale", 1.0),
                     scene.bending_multiplier);
    EXPECT_NO_THROW(simulation::Simulation(scene, simulation::Mode::kCoarse));
  }
  EXPECT_EQ(scenes.size(), 25U);
  EXPECT_EQ(steps, (std::set<int>{2, 4, 6}));
}

TEST_F(SceneSet, StillAirGetsABreezeInSomeAndNoAirNone) {
  scene_.erase("wind");
  write(scene_);
  options.scenes.sequences = 20;
  int windy = 0;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    windy += plan.scene.wind.velocity.isZero() ? 0 : 1;
    EXPECT_LE(plan.scene.wind.velocity.norm(), 1.5);
  }
  EXPECT_GT(windy, 0);
  EXPECT_LT(windy, 20);
  scene_["wind"] = {{"density", 0}};
  write(scene_);
  for (const SequencePlan& plan : plan_sequences(options.scenes)) EXPECT_TRUE(plan.scene.wind.velocity.isZero());
}

TEST_F(SceneSet, AStartThatVariationsWouldSpoilStays) {
  // A ball 1 mm in front of the cloth: most tilts run into it.
  scene_["obstacles"][0]["sphere"] = {{"center", {0.15, 0.9, 0.106}}, {"radius", 0.1}};
  write(scene_);
  options.scenes.sequences = 20;
  std::set<double> turned;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_NO_THROW(simulation::Simulation(plan.scene, simulation::Mode::kCoarse));
    turned.insert(plan.scene.transform.rotation.norm());
  }
  EXPECT_GT(turned.size(), 10U);
}

TEST_F(SceneSet, LargerSetsContainSmallerOnesAndSeedsDiffer) {
  write(scene_);
  const auto few = plan_sequences(options.scenes);
  options.scenes.sequences = 9;
  const auto more = plan_sequences(options.scenes);
  for (std::size_t i = 0; i < few.size(); ++i) {
    EXPECT_EQ(few[i].name, more[i].name);
    EXPECT_EQ(few[i].scene_json, more[i].scene_json);
  }
  options.scenes.seed = 2;
  EXPECT_NE(plan_sequences(options.scenes)[1].scene_json, few[1].scene_json);
}

TEST_F(SceneSet, AnAnimationIsSharedAndLastsForTheFastest) {
  scene_["frames"] = 8;
  scene_["obstacles"][0].erase("motion");
  json positions = json::array();
  for (int k = 0; k < 20; ++k) positions.insert(positions.end(), {0.15, 0.9, 0.3 - 0.01 * k});
  scene_["obstacles"][0]["animation"] = {{"positions", positions}};
  write(scene_);
  const auto plans = plan_sequences(options.scenes);
  for (const SequencePlan& plan : plans) {
    EXPECT_EQ(plan.samples, plans[0].samples);
    EXPECT_EQ(plan.samples->at(0).size(), 20U);
    EXPECT_EQ(plan.scene.obstacles[0].animation.samples.size(), 1U);
    EXPECT_EQ(plan.scene.transform.rotation, plans[0].scene.transform.rotation);  // what is worn keeps its place
  }
  EXPECT_NE(plans[1].scene.obstacles[0].animation.sample_time_s, 0.04);
  options.scenes.sequences = 1;
  make();
  const DatasetReader reader(options.folder);
  const auto ball = reader.obstacles("hung", 0, 8);
  EXPECT_NEAR(ball[7].front().center.z(), 0.23F, 1e-6F);
}

TEST_F(SceneSet, IsMadeResumesAndVerifies) {
  write(scene_);
  options.scenes.sequences = 3;
  make();
  EXPECT_THAT(check().problems, testing::IsEmpty());
  const DatasetReader reader(options.folder);
  std::map<std::string, std::string> splits;
  for (const SequenceInfo& info : reader.sequences()) splits[info.name] = info.split;
  EXPECT_EQ(splits, (std::map<std::string, std::string>{
                        {"hung", "test"}, {"hung-00", "train"}, {"hung-01", "train"}, {"hung-02", "test"}}));
  EXPECT_THAT(reader.master().material, HasSubstr("stretching"));
  const Positions before = reader.fine("hung-01", 3, 4).front();
  std::filesystem::remove(sequence("hung-01"));
  make();
  EXPECT_EQ(DatasetReader(options.folder).fine("hung-01", 3, 4).front(), before);
  options.scenes.seed = 2;
  EXPECT_EQ(error_of([&] { make(); }).code(), ErrorCode::kFailedPrecondition);
}

TEST_F(SceneSet, FaultsAreNamed) {
  const auto fault = [&] {
    const Error error = error_of([&] { plan_sequences(options.scenes); });
    EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument) << error.what();
    return std::string(error.what());
  };
  write(scene_);
  json other = scene_;
  write_obj(root / "larger.obj", cloth(8, 5));
  other["garmentFile"] = "larger.obj", other["name"] = "larger";
  write(other, "larger.json");
  options.scenes.own_scenes = {root / "hung.json", root / "larger.json"};
  EXPECT_THAT(fault(), HasSubstr("larger.json: another garment than "));
  options.scenes.own_scenes = {root / "hung.json", root / "hung.json"};
  EXPECT_THAT(fault(), HasSubstr("two scenes are named 'hung'"));
  scene_["obstacles"][0]["sphere"]["center"] = {0.15, 0.9, 0};
  write(scene_, "inside.json");
  EXPECT_THAT(fault(), HasSubstr("inside.json: "));
  options.scenes.sequences = 0;
  EXPECT_THAT(fault(), HasSubstr("variations"));
}

}  // namespace
}  // namespace pleat::dataset
