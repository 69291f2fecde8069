#include "services/dataset/dressed_sets.hpp"

#include <gmock/gmock.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <tuple>

#include "common/store/dataset.hpp"
#include "services/dataset/sequence.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/dataset/small_set.hpp"
#ifdef PLEAT_HAVE_SCENE_FILE
#include "services/presentation/input/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#endif

namespace pleat::dataset {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class DressedSets : public SmallSet {
 protected:
  DressedSets() {
    options.scenes.set = "skirt";
    options.scenes.garment = deploy / "garments/skirt-127.obj";
    options.scenes.material = deploy / "materials/isotropic-medium.json";
    options.scenes.body = deploy / "bodies/young-female.glb";
    options.scenes.motions = {deploy / "bodies"};
    options.scenes.train = options.scenes.test = 1;
    options.scenes.frames = 21;
    options.scenes.rounds = 1;
  }

  std::vector<SequencePlan> plan() { return plan_sequences(options.scenes, &notes); }

  // The first `frames` frames of the lambada as another clip, a line of frame `changed` replaced.
  fs::path clip(const std::string& name, int frames, int changed = -1, const std::string& joint = "",
                const std::string& values = "") {
    std::ifstream in(deploy / "bodies/lambada.amc");
    std::ostringstream out;
    int frame = 0;
    for (std::string line; std::getline(in, line);) {
      if (line.find_first_not_of("0123456789") == std::string::npos && ++frame > frames) break;
      out << (frame == changed && line.starts_with(joint + " ") ? joint + " " + values : line) << "\n";
    }
    fs::create_directories(root / "clips");
    fs::copy_file(deploy / "bodies/lambada.asf", root / "clips" / (name + ".asf"));
    std::ofstream(root / "clips" / (name + ".amc")) << out.str();
    return root / "clips" / (name + ".amc");
  }

  const fs::path deploy = options.scenes.material.parent_path().parent_path();
  std::vector<std::string> notes;
};

TEST_F(DressedSets, HaveThePapersSequencesAndTestMotions) {
  for (const char* set : {"skirt", "tshirt", "pants"}) {
    options.scenes.set = set;
    notes.clear();
    options.scenes.train = set_size(set, true).train;
    options.scenes.test = set_size(set, true).test;
    options.scenes.frames = set_size(set, true).frames;
    options.scenes.garment = deploy / set_defaults(set).garment;
    std::map<std::string, std::set<std::string>> motions;
    std::map<std::string, int> sequences;
    std::set<std::tuple<std::string, bool, double>> pieces;
    for (const SequencePlan& plan : plan()) {
      const BodyMotion& motion = *plan.body;
      EXPECT_TRUE(pieces.insert({motion.motion.stem(), motion.mirrored, motion.start_s}).second) << plan.name;
      EXPECT_LE(plan.scene.frames, options.scenes.frames);
      motions[plan.split].insert(motion.motion.stem());
      ++sequences[plan.split];
    }
    EXPECT_EQ(motions["test"], (std::set<std::string>{"05_04", "lambada"})) << set;
    EXPECT_EQ(sequences["test"], 2);
    EXPECT_EQ(sequences["train"], options.scenes.train) << set;
    EXPECT_FALSE(motions["train"].contains("05_04") || motions["train"].contains("lambada"));
  }
}

TEST_F(DressedSets, PiecesOfAMotionCoverItOnce) {
  options.scenes.motions = {clip("waltz", 481)};  // 4 s: 101 frames
  options.scenes.frames = 57;                     // 40 and the way into it
  options.scenes.train = 6;
  options.scenes.test = 0;
  const std::vector<SequencePlan> plans = plan();
  ASSERT_EQ(plans.size(), 6u);
  int covered = 0;
  for (std::size_t i = 0; i < plans.size(); ++i) {
    const BodyMotion& motion = *plans[i].body;
    EXPECT_EQ(motion.mirrored, i >= 3);
    EXPECT_NEAR(motion.start_s, 0.04 * (covered % 101), 1e-9);
    covered += plans[i].scene.frames - motion.ease_frames;
    EXPECT_LE(plans[i].scene.frames, 57);
  }
  EXPECT_EQ(covered, 202);
}

TEST_F(DressedSets, LeaveOutPosesThatClothCannotBeWornInAndSayWhy) {
  options.scenes.frames = 200;
  options.scenes.train = 8;
  options.scenes.test = 0;
  options.scenes.motions = {clip("good", 240), clip("jump", 360, 121, "root", "60 17 -27 0 0 0"), clip("blink", 60)};
  const std::vector<SequencePlan> plans = plan();
  // Of the one that jumps after 0.99 s the longer stretch behind that, of each also the mirror image.
  ASSERT_EQ(plans.size(), 4u);
  for (const SequencePlan& plan : plans) {
    const bool jumps = plan.body->motion.stem() == "jump";
    EXPECT_GE(plan.body->start_s, jumps ? 0.99 : 0.0);
  }
  EXPECT_THAT(notes, Contains(HasSubstr("jump.amc, 0.9")));
  EXPECT_THAT(notes, Contains(HasSubstr("blink.amc is left out: shorter than a second")));
  EXPECT_THAT(notes, Contains(HasSubstr("4 of 8 sequences (train)")));
}

TEST_F(DressedSets, RefuseWhatTheyCanNotMake) {
  options.scenes.frames = 18;
  EXPECT_EQ(test::error_of([&] { plan(); }).code(), ErrorCode::kInvalidArgument);
  options.scenes.frames = 21;
  options.scenes.motions = {root};
  EXPECT_EQ(test::error_of([&] { plan(); }).code(), ErrorCode::kInvalidArgument);
}

TEST_F(DressedSets, AreMadeVerifiedAndGoneOnWith) {
  make();
  EXPECT_THAT(check().problems, IsEmpty());
  const DatasetReader reader(options.folder);
  EXPECT_TRUE(reader.master().tracked);
  ASSERT_EQ(reader.sequences().size(), 2u);
  for (const SequenceInfo& info : reader.sequences()) {
    EXPECT_EQ(info.frames_complete, info.frames);
    const auto body = reader.obstacles(info.name, 0, info.frames);
    EXPECT_EQ(body[0].at(0).positions.rows(), 13380);
    EXPECT_GT((body.back().at(0).positions - body[0].at(0).positions).rowwise().norm().maxCoeff(), 0.1f);
  }
  // Once more: nothing is left to do.
  std::vector<std::string> messages;
  generate(options, [&](const Progress& progress) { messages.push_back(progress.message); });
  EXPECT_THAT(messages, ::testing::Not(Contains(HasSubstr("begins"))));
}

TEST_F(DressedSets, WhatWasDroppedStaysOutOfTheSet) {
  const std::vector<SequencePlan> plans = plan();
  ASSERT_EQ(plans.size(), 2u);
  fs::create_directories(options.folder / "sequences");
  drop_sequence(options.folder, plans[1], "frame 7: the garment is 900 mm from where it was worn");
  EXPECT_EQ(why_dropped(options.folder, plans[0]), std::nullopt);
  make();
  EXPECT_EQ(DatasetReader(options.folder).master().sequences, std::vector<std::string>{"skirt-00"});
  EXPECT_THAT(check().problems, IsEmpty());
  EXPECT_THAT(to_lines(describe(options.folder)),
              Contains(HasSubstr("skirt-01: dropped, frame 7: the garment is 900")));
  // Of another scene: it does not count.
  SequencePlan other = plans[1];
  other.scene_json += " ";
  EXPECT_EQ(why_dropped(options.folder, other), std::nullopt);
}

#ifdef PLEAT_HAVE_SCENE_FILE
TEST_F(DressedSets, ScenesOfTheFilesAreTheScenesThatWereSimulated) {
  SequencePlan plan = this->plan()[0];
  put_body(plan.scene, *plan.body);
  const auto read =
      simulation::scene_from_message(presentation::parse_scene(plan.scene_json, "scene", deploy / "scenes"));
  EXPECT_EQ(read.frames, plan.scene.frames);
  EXPECT_EQ(read.steps_per_frame, plan.scene.steps_per_frame);
  EXPECT_EQ(read.contact.obstacle_friction, plan.scene.contact.obstacle_friction);
  const simulation::Obstacle &a = read.obstacles.at(0), &b = plan.scene.obstacles.at(0);
  EXPECT_EQ(a.mesh.faces, b.mesh.faces);
  EXPECT_EQ(a.mesh.rest_positions, b.mesh.rest_positions);
  ASSERT_EQ(a.animation.samples.size(), b.animation.samples.size());
  EXPECT_EQ(a.animation.samples.back(), b.animation.samples.back());
}
#endif

}  // namespace
}  // namespace pleat::dataset
