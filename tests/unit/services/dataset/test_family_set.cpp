#include "services/dataset/family_set.hpp"

#include <gmock/gmock.h>

#include <set>
#include <string>

#include "common/mesh/obj.hpp"
#include "common/store/dataset.hpp"
#include "services/dataset/placement.hpp"
#include "services/dataset/shards.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/dataset/small_set.hpp"
#ifdef PLEAT_HAVE_SCENE_FILE
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#endif

namespace pleat::dataset {
namespace {

class Family : public SmallSet {
 protected:
  Family() {
    options.scenes.set = kFamily;
    const std::filesystem::path folder = options.scenes.material.parent_path();
    options.scenes.materials = {folder / "silk.json", folder / "denim.json"};
    options.scenes.garment.clear();
    options.scenes.material.clear();
  }
};

TEST_F(Family, EverySequenceHasAGarmentAMaterialAndAScene) {
  options.scenes.train = 14;
  options.scenes.test = 2;
  const auto plans = plan_sequences(options.scenes);
  ASSERT_EQ(plans.size(), 16u);
  std::set<std::string> garments, materials, motions;
  for (std::size_t i = 0; i < plans.size(); ++i) {
    const SequencePlan& plan = plans[i];
    EXPECT_EQ(plan.split, i < 14 ? "train" : "test");
    EXPECT_TRUE(plan.own_meshes);
    EXPECT_TRUE(plan.tracked);
    EXPECT_EQ(fault_of_start(plan.scene), "");
    garments.insert(topology_hash(plan.scene.garment));
    materials.insert(plan.material_json);
    motions.insert(std::to_string(plan.scene.handles.size()) + " " + std::to_string(plan.scene.obstacles.size()) + " " +
                   std::to_string(!plan.scene.wind.velocity.isZero()) +
                   std::to_string(!plan.scene.handles.empty() && !plan.scene.handles[0].motion.keys.empty()));
    EXPECT_GE(plan.scene.material.density, 0.05);
    EXPECT_LE(plan.scene.material.density, 0.5);
  }
  EXPECT_EQ(garments.size(), 16u);
  EXPECT_GT(materials.size(), 8u);
  EXPECT_GE(motions.size(), 5u);
}

TEST_F(Family, ALargerSetContainsTheSmallerOne) {
  options.scenes.train = 2;
  options.scenes.test = 1;
  const auto few = plan_sequences(options.scenes);
  options.scenes.extra = 2;
  const auto more = plan_sequences(options.scenes);
  ASSERT_EQ(more.size(), 5u);
  for (std::size_t i = 0; i < few.size(); ++i) {
    EXPECT_EQ(more[i].scene_json, few[i].scene_json);
    EXPECT_EQ(topology_hash(more[i].scene.garment), topology_hash(few[i].scene.garment));
  }
  options.scenes.seed = 2;
  EXPECT_NE(plan_sequences(options.scenes)[0].scene_json, few[0].scene_json);
}

TEST_F(Family, IsMadeVerifiedAndGoneOnWith) {
  options.scenes.train = 2;
  options.scenes.test = 1;
  options.scenes.frames = 3;
  options.scenes.rounds = 1;
  make();
  EXPECT_THAT(check().problems, ::testing::IsEmpty());
  {
    const DatasetReader reader(options.folder);
    EXPECT_TRUE(reader.master().material.empty()) << "each sequence has its own";
    EXPECT_TRUE(reader.master().normalization.has_value());
    std::set<std::string> hashes;
    for (const SequenceInfo& info : reader.sequences()) {
      EXPECT_TRUE(info.own_meshes);
      const auto meshes = reader.meshes(info.name);
      EXPECT_EQ(topology_hash(meshes->fine), info.topology_hash);
      EXPECT_EQ(meshes->fine.face_count(), 4 * meshes->coarse.face_count());
      EXPECT_EQ(reader.fine(info.name, 0, 3).size(), 3u);
      hashes.insert(info.topology_hash);
    }
    EXPECT_EQ(hashes.size(), 3u);
    EXPECT_EQ(topology_hash(reader.topology().fine), topology_hash(reader.meshes("family-00")->fine));
  }
  const auto written = std::filesystem::last_write_time(sequence("family-01"));
  std::filesystem::remove(sequence("family-02"));
  make();
  EXPECT_EQ(std::filesystem::last_write_time(sequence("family-01")), written);
  EXPECT_TRUE(std::filesystem::exists(sequence("family-02")));
  EXPECT_EQ(test::error_of([&] {
              options.scenes.seed = 2;
              make();
            }).code(),
            ErrorCode::kFailedPrecondition);
}

TEST_F(Family, ShardsMakeTheSameBits) {
  options.scenes.train = 1;
  options.scenes.test = 1;
  options.scenes.frames = 2;
  options.scenes.rounds = 1;
  make();
  GenerateOptions sharded = options;
  sharded.folder = root / "sharded";
  const auto quiet = [](const Progress&) {};
  EXPECT_EQ(generate_shard(sharded, {{1, 2, "test"}, std::chrono::seconds(5), {}}, quiet), ShardEnd::kDone);
  EXPECT_EQ(merge(sharded.folder, sharded.margin, [](const std::string&) {}), ShardEnd::kDone);
  const DatasetReader one(options.folder), other(sharded.folder);
  EXPECT_EQ(*one.master().normalization, *other.master().normalization);
  for (const char* name : {"family-00", "family-01"}) {
    EXPECT_EQ(one.fine(name, 1, 2)[0], other.fine(name, 1, 2)[0]);
    EXPECT_EQ(topology_hash(one.meshes(name)->coarse), topology_hash(other.meshes(name)->coarse));
  }
}

#ifdef PLEAT_HAVE_SCENE_FILE
TEST_F(Family, ScenesOfTheFilesAreTheScenesThatWereSimulated) {
  options.scenes.train = 13;
  options.scenes.test = 0;
  options.scenes.frequency = 20;
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    SCOPED_TRACE(plan.name);
    // The garment is in the sequence's file.
    write_obj(root / "own.obj", plan.scene.garment);
    const std::string text = "{\"garmentFile\":\"own.obj\"," + plan.scene_json.substr(1);
    const auto read = simulation::scene_from_message(presentation::parse_scene(text, "scene", root));
    EXPECT_EQ(read.steps_per_frame, plan.scene.steps_per_frame);
    EXPECT_EQ(read.damping_s, plan.scene.damping_s);
    EXPECT_EQ(read.contact.friction, plan.scene.contact.friction);
    EXPECT_EQ(read.contact.obstacle_friction, plan.scene.contact.obstacle_friction);
    EXPECT_EQ(read.material.density, plan.scene.material.density);
    EXPECT_EQ(read.material.stretching, plan.scene.material.stretching);
    EXPECT_EQ(read.material.bending, plan.scene.material.bending);
    EXPECT_EQ(read.tracking.frequency, 20);
    EXPECT_LT((read.wind.velocity - plan.scene.wind.velocity).norm(), 1e-12);
    EXPECT_LT((read.transform.rotation - plan.scene.transform.rotation).norm(), 1e-9);
    EXPECT_LT((read.transform.translation - plan.scene.transform.translation).norm(), 1e-12);
    const auto expect_motion = [](const simulation::Motion& a, const simulation::Motion& b) {
      ASSERT_EQ(a.keys.size(), b.keys.size());
      for (std::size_t k = 0; k < a.keys.size(); ++k) {
        EXPECT_EQ(a.keys[k].time_s, b.keys[k].time_s);
        EXPECT_LT((a.keys[k].translation - b.keys[k].translation).norm(), 1e-12);
        EXPECT_LT((a.keys[k].rotation - b.keys[k].rotation).norm(), 1e-9);
      }
    };
    ASSERT_EQ(read.handles.size(), plan.scene.handles.size());
    for (std::size_t h = 0; h < read.handles.size(); ++h) {
      EXPECT_EQ(read.handles[h].vertices, plan.scene.handles[h].vertices);
      expect_motion(read.handles[h].motion, plan.scene.handles[h].motion);
    }
    ASSERT_EQ(read.obstacles.size(), plan.scene.obstacles.size());
    for (std::size_t o = 0; o < read.obstacles.size(); ++o) {
      const simulation::Obstacle &a = read.obstacles[o], &b = plan.scene.obstacles[o];
      EXPECT_EQ(a.center, b.center);
      EXPECT_EQ(a.radius, b.radius);
      EXPECT_EQ(a.mesh.rest_positions, b.mesh.rest_positions);
      EXPECT_EQ(a.capsules.size(), b.capsules.size());
      expect_motion(a.motion, b.motion);
    }
  }
}
#endif

}  // namespace
}  // namespace pleat::dataset
