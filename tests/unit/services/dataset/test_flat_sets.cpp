#include "services/dataset/flat_sets.hpp"

#include <gmock/gmock.h>

#include <cmath>
#include <set>
#include <tuple>
#include <utility>

#include "common/mesh/garment.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "tests/unit/services/dataset/small_set.hpp"
#ifdef PLEAT_HAVE_SCENE_FILE
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#endif

namespace pleat::dataset {
namespace {

class FlatSets : public SmallSet {
 protected:
  void choose(const std::string& set, bool full) {
    const SetSize size = set_size(set, full);
    options.scenes.set = set;
    options.scenes.train = size.train;
    options.scenes.test = size.test;
    options.scenes.frames = size.frames;
    options.scenes.tracked = set_defaults(set).tracked;
    options.scenes.garment = deploy() / set_defaults(set).garment;
  }
  std::filesystem::path deploy() const { return options.scenes.material.parent_path().parent_path(); }
};

TEST_F(FlatSets, SheetHasEveryShapeSizeAndStart) {
  choose("sheet", true);
  const auto plans = plan_sequences(options.scenes);
  ASSERT_EQ(plans.size(), 20u);
  std::set<std::tuple<bool, bool, double>> train, test;
  for (const SequencePlan& plan : plans) {
    EXPECT_EQ(plan.scene.frames, 200);
    EXPECT_EQ(plan.scene.garment.vertex_count(), 289);
    EXPECT_EQ(plan.scene.subdivision_rounds, 2);
    EXPECT_FALSE(plan.tracked);
    EXPECT_EQ(plan.scene.handles.at(0).vertices.size(), 2u);
    const simulation::Obstacle& o = plan.scene.obstacles.at(0);
    const bool pole = !o.capsules.empty(), hangs = plan.scene.transform.rotation.norm() > 1;
    (plan.split == "train" ? train : test).insert({pole, hangs, pole ? o.capsules[0].radius : o.radius});
    const auto& keys = o.motion.keys;
    ASSERT_GE(keys.size(), 2u);
    const double speed = (keys[1].translation - keys[0].translation).norm() / (keys[1].time_s - keys[0].time_s);
    EXPECT_GE(speed, 0.3);
    EXPECT_LE(speed, 1.0);
    EXPECT_GE(keys.back().time_s, 200 * 0.04 - 6);
  }
  EXPECT_EQ(train.size(), 12u);
  EXPECT_EQ(test.size(), 4u);
}

// [DT-S] table 3 changes the coarse mesh and keeps the fine one.
TEST_F(FlatSets, SheetsOfAllFactorsHaveOneFineMesh) {
  const auto places = [](const Positions& p) {
    std::set<std::tuple<long, long, long>> all;
    for (Eigen::Index v = 0; v < p.rows(); ++v) {
      all.insert({std::lround(1e4 * static_cast<double>(p(v, 0))), std::lround(1e4 * static_cast<double>(p(v, 1))),
                  std::lround(1e4 * static_cast<double>(p(v, 2)))});
    }
    return all;
  };
  std::set<std::tuple<long, long, long>> first;
  for (const auto& [rounds, coarse] : {std::pair{2, 289}, {3, 81}, {4, 25}}) {
    std::vector<std::string> notes;
    const Topology cloth = read_garment(deploy() / set_defaults("sheet", rounds).garment, notes);
    EXPECT_EQ(cloth.vertex_count(), coarse);
    const Topology fine = subdivide(cloth, rounds).fine;
    EXPECT_EQ(fine.face_count(), 8192);
    EXPECT_EQ(fine.vertex_count(), 4225);
    if (first.empty()) first = places(fine.rest_positions);
    EXPECT_EQ(places(fine.rest_positions), first);
  }
}

TEST_F(FlatSets, DiskHasWindsOfItsWholeRange) {
  choose("disk", true);
  const auto plans = plan_sequences(options.scenes);
  ASSERT_EQ(plans.size(), 10u);
  double slowest = 1e9, fastest = 0;
  for (const SequencePlan& plan : plans) {
    EXPECT_EQ(plan.scene.garment.vertex_count(), 148);
    EXPECT_EQ(plan.scene.subdivision_rounds, 3);
    EXPECT_EQ(plan.scene.handles.at(0).vertices.size(), 10u);
    const simulation::Wind& wind = plan.scene.wind;
    slowest = std::min(slowest, wind.velocity.norm());
    fastest = std::max(fastest, wind.velocity.norm());
    EXPECT_EQ(wind.velocity.y(), 0);
  }
  EXPECT_GE(slowest, 1);
  EXPECT_LT(slowest, 2.5);
  EXPECT_GT(fastest, 6.5);
  EXPECT_LE(fastest, 8);
}

TEST_F(FlatSets, TheFrequencyOfAveragesCanBeChosen) {
  choose("draping", false);
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_EQ(plan.scene.tracking.frequency, simulation::Tracking::kDefaultFrequency);
  }
  options.scenes.frequency = 20;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_EQ(plan.scene.tracking.frequency, 20);
    EXPECT_THAT(plan.scene_json, testing::HasSubstr("\"frequency\":20"));
  }
  options.scenes.springs = true;
  EXPECT_THROW(plan_sequences(options.scenes), Error) << "springs have none";
  options.scenes.springs = false;
  options.scenes.tracked = false;
  EXPECT_THROW(plan_sequences(options.scenes), Error) << "a free cloth follows nothing";
}

TEST_F(FlatSets, SmallOnesAreMadeAndVerified) {
  for (const char* set : {"sheet", "disk"}) {
    choose(set, false);
    options.folder = root / set;
    options.scenes.train = options.scenes.test = 1;
    options.scenes.frames = 3;
    options.scenes.rounds = 1;
    make();
    EXPECT_THAT(check().problems, ::testing::IsEmpty()) << set;
    const DatasetReader reader(options.folder);
    EXPECT_FALSE(reader.master().tracked);
    EXPECT_EQ(reader.topology().fine.face_count(), 4 * reader.topology().coarse.face_count());
  }
}

#ifdef PLEAT_HAVE_SCENE_FILE
TEST_F(FlatSets, ScenesOfTheFilesAreTheScenesThatWereSimulated) {
  for (const char* set : {"sheet", "disk"}) {
    choose(set, false);
    const std::filesystem::path scenes = deploy() / "scenes";
    for (const SequencePlan& plan : plan_sequences(options.scenes)) {
      const auto read = simulation::scene_from_message(presentation::parse_scene(plan.scene_json, "scene", scenes));
      EXPECT_EQ(read.subdivision_rounds, plan.scene.subdivision_rounds);
      EXPECT_EQ(read.handles.at(0).vertices, plan.scene.handles.at(0).vertices);
      EXPECT_LT((read.transform.rotation - plan.scene.transform.rotation).norm(), 1e-9);
      EXPECT_EQ(read.perturbation_m, plan.scene.perturbation_m);
      EXPECT_LT((read.wind.velocity - plan.scene.wind.velocity).norm(), 1e-9);
      const simulation::Obstacle &a = read.obstacles.at(0), &b = plan.scene.obstacles.at(0);
      EXPECT_EQ(a.radius, b.radius);
      EXPECT_EQ(a.center, b.center);
      ASSERT_EQ(a.capsules.size(), b.capsules.size());
      for (std::size_t k = 0; k < a.capsules.size(); ++k) {
        EXPECT_EQ(a.capsules[k].a, b.capsules[k].a);
        EXPECT_EQ(a.capsules[k].b, b.capsules[k].b);
        EXPECT_EQ(a.capsules[k].radius, b.capsules[k].radius);
      }
      EXPECT_EQ(a.mesh.faces, b.mesh.faces);
      EXPECT_EQ(a.mesh.rest_positions, b.mesh.rest_positions);
      EXPECT_EQ(a.motion.keys.size(), b.motion.keys.size());
    }
  }
}
#endif

}  // namespace
}  // namespace pleat::dataset
