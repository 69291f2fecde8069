#include <gmock/gmock.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "common/store/dataset.hpp"
#include "services/dataset/normalization.hpp"
#include "services/dataset/sequence.hpp"
#include "tests/unit/services/dataset/small_set.hpp"
#ifdef PLEAT_HAVE_SCENE_FILE
#include "services/presentation/input/scene_file.hpp"
#endif

namespace pleat::dataset {
namespace {

std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

ErrorCode code_of(const std::function<void()>& action, const std::string& part) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    return error.code();
  }
  ADD_FAILURE() << "no error";
  return ErrorCode::kInternal;
}

// So that a larger data set contains the smaller one, and judges with the same test sequences.
TEST_F(SmallSet, FurtherSequencesComeBehindAndHoldNoVertexOfTheTestSplit) {
  for (const char* set : {"draping", "hitting"}) {
    options.scenes.set = set;
    options.scenes.train = 3;
    options.scenes.test = 2;
    options.scenes.extra = 0;
    const auto plans = plan_sequences(options.scenes);
    options.scenes.extra = 12;
    const auto more = plan_sequences(options.scenes);
    ASSERT_EQ(more.size(), 17u);
    std::set<std::string> scenes;
    for (std::size_t i = 0; i < more.size(); ++i) {
      auto scene = nlohmann::json::parse(more[i].scene_json);
      scene.erase("name");
      scenes.insert(scene.dump());
      if (i < plans.size()) {
        EXPECT_EQ(more[i].name, plans[i].name);
        EXPECT_EQ(more[i].split, plans[i].split);
        EXPECT_EQ(more[i].scene_json, plans[i].scene_json);
        continue;
      }
      EXPECT_EQ(more[i].split, "train");
      for (const std::size_t test : {3u, 4u}) {
        const bool held = more[i].scene.handles[0].vertices == plans[test].scene.handles[0].vertices;
        EXPECT_EQ(held, options.scenes.set == "hitting") << more[i].name;
      }
    }
    EXPECT_EQ(scenes.size(), 17u) << "a scene twice";
  }
}

TEST_F(SmallSet, PlansDifferAndRepeat) {
  options.scenes.train = 5;
  options.scenes.test = 2;
  const auto plans = plan_sequences(options.scenes);
  ASSERT_EQ(plans.size(), 7u);
  std::set<std::uint32_t> held;
  std::set<std::string> names;
  for (const SequencePlan& plan : plans) {
    names.insert(plan.name);
    ASSERT_EQ(plan.scene.handles.size(), 1u);
    ASSERT_EQ(plan.scene.handles[0].vertices.size(), 1u);
    const std::uint32_t vertex = plan.scene.handles[0].vertices[0];
    held.insert(vertex);
    EXPECT_FLOAT_EQ(plan.scene.garment.rest_positions(vertex, 2), -0.2f) << "not on the upper edge";
  }
  EXPECT_EQ(names.size(), 7u);
  EXPECT_EQ(held.size(), 7u) << "a vertex is held twice";
  EXPECT_EQ(plans[4].split, "train");
  EXPECT_EQ(plans[5].split, "test");
  EXPECT_EQ(plan_sequences(options.scenes)[3].scene_json, plans[3].scene_json);
  options.scenes.extra = 1'000'000'000;
  EXPECT_EQ(code_of([&] { plan_sequences(options.scenes); }, "at most"), ErrorCode::kInvalidArgument);
  options.scenes.extra = 0;
  options.scenes.seed = 2;
  EXPECT_NE(plan_sequences(options.scenes)[3].scene_json, plans[3].scene_json);
  options.scenes.train = 10;
  held.clear();
  for (const SequencePlan& plan : plan_sequences(options.scenes)) held.insert(plan.scene.handles[0].vertices[0]);
  EXPECT_EQ(held.size(), 12u) << "beyond the upper edge those next to it";
  options.scenes.train = 1000;
  EXPECT_EQ(code_of([&] { plan_sequences(options.scenes); }, "has only"), ErrorCode::kInvalidArgument);
  options.scenes.set = "kilt";
  EXPECT_EQ(code_of([&] { plan_sequences(options.scenes); }, "kilt"), ErrorCode::kInvalidArgument);
}

TEST_F(SmallSet, AGarmentThatIsUprightHangsByItsTop) {
  options.scenes.garment = "deploy/garments/skirt.obj";
  options.scenes.train = 10;
  options.scenes.test = 3;
  for (const char* set : {"draping", "hitting"}) {
    options.scenes.set = set;
    const auto plans = plan_sequences(options.scenes);
    EXPECT_EQ(plans.size(), 13u);
    for (const SequencePlan& plan : plans) {
      const auto& rest = plan.scene.garment.rest_positions;
      const float top = rest.col(1).maxCoeff(), bottom = rest.col(1).minCoeff();
      for (const std::uint32_t v : plan.scene.handles[0].vertices) {
        EXPECT_GT(rest(v, 1), top - 0.2f * (top - bottom)) << plan.name;
      }
    }
  }
}

TEST_F(SmallSet, AClosedGarmentHasATopToo) {
  std::ofstream(root / "tent.obj") << "v 0 0 0\nv 1 0 0\nv 0.5 0 0.8\nv 0.5 0.8 0.3\nvt 0 0\nvt 1 0\nvt 0.5 0.9\n"
                                      "vt 1.5 0.9\nvt 2 0\nvt 1 1.8\n"
                                      "f 1/1 4/3 2/2\nf 2/2 4/3 3/4\nf 3/2 4/4 1/5\nf 1/4 2/3 3/6\n";
  options.scenes.garment = root / "tent.obj";
  options.scenes.set = "hitting";
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    EXPECT_THAT(plan.scene.handles[0].vertices, testing::ElementsAre(3u));
  }
}

TEST_F(SmallSet, NotesOfTheGarmentComeOut) {
  options.scenes.garment = "tests/cases/11-garment-centimetres/skirt-cm.obj";
  std::vector<std::string> notes;
  plan_sequences(options.scenes, &notes);
  EXPECT_EQ(notes.size(), 1u);
  options.scenes.garment_scale = 0.01;
  notes.clear();
  const auto plans = plan_sequences(options.scenes, &notes);
  EXPECT_TRUE(notes.empty());
  EXPECT_LT(plans[0].scene.garment.rest_positions.cwiseAbs().maxCoeff(), 1.0f);
  options.scenes.garment = "tests/cases/11-garment-centimetres/skirt-mm-uv-m.obj";
  options.scenes.garment_scale = 1;
  EXPECT_EQ(code_of([&] { plan_sequences(options.scenes); }, "times as long in space"), ErrorCode::kInvalidArgument);
}

TEST_F(SmallSet, ScenesAreSceneFiles) {
  for (const char* set : {"draping", "hitting"}) {
    options.scenes.set = set;
    for (const SequencePlan& plan : plan_sequences(options.scenes)) {
      const auto json = nlohmann::json::parse(plan.scene_json);
      EXPECT_EQ(json["name"], plan.name);
      EXPECT_EQ(json["frames"], 5);
      EXPECT_EQ(json["garmentFile"], "../garments/cloth.obj");
      EXPECT_EQ(json["handles"][0]["hard"], true);
#ifdef PLEAT_HAVE_SCENE_FILE
      for (const char* folder : {"scenes", "garments", "materials"}) std::filesystem::create_directories(root / folder);
      std::filesystem::copy_file(options.scenes.garment, root / "garments/cloth.obj",
                                 std::filesystem::copy_options::overwrite_existing);
      std::filesystem::copy_file(options.scenes.material, root / "materials/gray-interlock.json",
                                 std::filesystem::copy_options::overwrite_existing);
      const v1::Scene scene = presentation::parse_scene(plan.scene_json, "scene", root / "scenes");
      EXPECT_EQ(scene.handles(0).vertices(0), plan.scene.handles[0].vertices[0]);
      EXPECT_EQ(scene.frame_time_s(), plan.scene.frame_time_s);
      EXPECT_EQ(scene.steps_per_frame(), static_cast<std::uint32_t>(plan.scene.steps_per_frame));
      EXPECT_EQ(scene.obstacles_size(), set == std::string("hitting") ? 1 : 0);
#endif
    }
  }
}

TEST_F(SmallSet, ScenesSayHowTheFineClothIsTracked) {
  const auto tracking = [&] { return nlohmann::json::parse(plan_sequences(options.scenes)[0].scene_json)["tracking"]; };
  EXPECT_EQ(tracking(), (nlohmann::json{{"frequency", 7.0}}));
  options.scenes.springs = true;
  EXPECT_EQ(tracking(), (nlohmann::json{{"spring", 10.0}, {"twoLevel", true}}));
  options.scenes.tracked = false;
  EXPECT_TRUE(tracking().is_null());
}

TEST_F(SmallSet, HittingKeepsASizeAndPlacesForTheTestSplit) {
  options.scenes.set = "hitting";
  const SetSize size = set_size("hitting", true);
  EXPECT_EQ(size.train, 27);
  EXPECT_EQ(size.test, 8);
  EXPECT_EQ(size.frames, 1000);
  options.scenes.train = size.train;
  options.scenes.test = size.test;
  std::set<double> radii[2];
  // Places to within the random shift of 3 cm; the side is the sign of z.
  const auto near = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    return (a - b).head<2>().cwiseAbs().maxCoeff() <= 0.06 && (a.z() > 0) == (b.z() > 0);
  };
  std::vector<Eigen::Vector3d> places[2];
  for (const SequencePlan& plan : plan_sequences(options.scenes)) {
    const simulation::Obstacle& ball = plan.scene.obstacles[0];
    radii[plan.split == "test" ? 1 : 0].insert(ball.radius);
    places[plan.split == "test" ? 1 : 0].push_back(ball.center);
  }
  std::size_t unseen_radii = 0, unseen_places = 0, seen_places = 0;
  for (const double radius : radii[1]) unseen_radii += radii[0].count(radius) == 0 ? 1 : 0;
  for (const Eigen::Vector3d& place : places[1]) {
    const bool seen = std::any_of(places[0].begin(), places[0].end(), [&](const auto& p) { return near(p, place); });
    ++(seen ? seen_places : unseen_places);
  }
  EXPECT_EQ(radii[0].size(), 4u);
  EXPECT_EQ(unseen_radii, 1u);
  EXPECT_GE(unseen_places, 4u);
  EXPECT_GE(seen_places, 1u);
}

TEST_F(SmallSet, FreeFineSimulationsGoTheirOwnWay) {
  options.scenes.train = options.scenes.test = 1;
  options.scenes.frames = 12;
  const auto distance = [&](const std::filesystem::path& folder) {
    const DatasetReader reader(folder);
    double sum = 0;
    for (const SequenceInfo& info : reader.sequences()) {
      const Positions coarse = reader.coarse(info.name, 11, 12)[0], fine = reader.fine(info.name, 11, 12)[0];
      for (std::size_t i = 0; i < reader.topology().feature_vertices.size(); ++i) {
        sum += static_cast<double>(
            (fine.row(reader.topology().feature_vertices[i]) - coarse.row(static_cast<Eigen::Index>(i))).norm());
      }
    }
    return sum;
  };
  const std::filesystem::path tracked = root / "tracked", free = root / "free";
  options.folder = tracked;
  generate(options, [](const Progress&) {});
  options.folder = free;
  options.scenes.tracked = false;
  generate(options, [](const Progress&) {});
  EXPECT_TRUE(DatasetReader(tracked).master().tracked);
  EXPECT_FALSE(DatasetReader(free).master().tracked);
  EXPECT_GT(distance(free), distance(tracked));
  options.scenes.tracked = true;
  EXPECT_THROW(generate(options, [](const Progress&) {}), Error) << "one folder, one kind";
}

TEST_F(SmallSet, AnotherMaterialUnderTheSameNameIsRefused) {
  options.scenes.train = options.scenes.test = 1;
  const std::filesystem::path material = root / "material.json";
  std::filesystem::copy_file(options.scenes.material, material);
  options.scenes.material = material;
  generate(options, [](const Progress&) {});
  std::ofstream(material, std::ios::app) << "\n";
  EXPECT_THROW(generate(options, [](const Progress&) {}), Error);
}

TEST_F(SmallSet, MakesWhatWasPlanned) {
  Progress last;
  generate(options, [&](const Progress& progress) { last = progress; });
  EXPECT_EQ(last.frames_done, 15u);
  EXPECT_EQ(last.frames, 15u);
  const DatasetReader reader(options.folder);
  EXPECT_EQ(reader.master().git_revision, "abc");
  EXPECT_EQ(reader.master().time_step_s, 0.005);
  ASSERT_EQ(reader.sequences().size(), 3u);
  for (const SequenceInfo& info : reader.sequences()) {
    EXPECT_TRUE(info.finished);
    EXPECT_EQ(info.frames_complete, 5u);
    // It falls.
    const float start = reader.fine(info.name, 0, 1)[0].col(1).mean();
    EXPECT_LT(reader.fine(info.name, 4, 5)[0].col(1).mean(), start - 0.01f);
  }
  const ChannelRanges tight = measure_range(reader, 0);
  for (std::size_t c = 0; c < 9; ++c) {
    EXPECT_LT(reader.master().normalization->offset[c], tight.offset[c]);
    EXPECT_GT(reader.master().normalization->scale[c], tight.scale[c]);
  }
  for (std::size_t c = 3; c < 6; ++c) {
    EXPECT_GE(tight.offset[c], -1.0001f);
    EXPECT_LE(tight.offset[c] + tight.scale[c], 1.0001f);
  }
}

TEST_F(SmallSet, GoesOnWhereItStopped) {
  make();
  const std::string whole = bytes_of(sequence("draping-01"));
  const std::string other = bytes_of(sequence("draping-00"));
  ASSERT_FALSE(whole.empty());
  // Two frames, as if killed there.
  std::filesystem::remove(sequence("draping-01"));
  const auto plans = plan_sequences(options.scenes);
  struct Stop {};
  EXPECT_THROW(make_sequence(options.folder, plans[1], true,
                             [](std::uint64_t frames) {
                               if (frames == 2) throw Stop();
                             }),
               Stop);
  EXPECT_EQ(DatasetReader(options.folder).sequences()[1].frames_complete, 2u);
  std::uint64_t first_seen = 0;
  generate(options, [&](const Progress& progress) {
    if (first_seen == 0) first_seen = progress.frames_done;
  });
  EXPECT_EQ(first_seen, 12u);
  EXPECT_EQ(bytes_of(sequence("draping-01")), whole) << "a continued sequence has the same bits";
  EXPECT_EQ(bytes_of(sequence("draping-00")), other);
}

TEST_F(SmallSet, RefusesAnotherDataSetsFolder) {
  options.scenes.train = 1;
  options.scenes.test = 0;
  make();
  options.scenes.seed = 9;
  EXPECT_EQ(code_of([&] { make(); }, "other options"), ErrorCode::kFailedPrecondition);
  options.scenes.seed = 1;
  options.scenes.frames = 6;
  EXPECT_EQ(code_of([&] { make(); }, "draping-00"), ErrorCode::kFailedPrecondition);
}

TEST_F(SmallSet, AFailingSequenceIsNamed) {
  options.scenes.train = 1;
  options.scenes.test = 0;
  // A folder where the sequence should be.
  std::filesystem::create_directories(sequence("draping-00"));
  EXPECT_NE(code_of([&] { make(); }, "draping-00"), ErrorCode::kCancelled);
}

TEST_F(SmallSet, WhatIsInTheWayOfARecordingIsSetAside) {
  options.scenes.train = 1;
  options.scenes.test = 0;
  const std::string partial = sequence("draping-00").string() + ".partial";
  std::filesystem::create_directories(partial + "/mine");
  make();
  EXPECT_EQ(DatasetReader(options.folder).sequences().at(0).frames_complete, 5u);
  EXPECT_TRUE(std::filesystem::is_directory(partial + ".aside-1/mine"));
}

TEST_F(SmallSet, WhatIsNoCheckpointIsSetAside) {
  options.scenes.train = 2;
  options.scenes.test = 0;
  const std::string file = options.folder / "sequences/draping-00.checkpoint",
                    link = options.folder / "sequences/draping-01.checkpoint", precious = root / "precious";
  std::filesystem::create_directories(options.folder / "sequences");
  std::ofstream(file) << "mine";
  std::ofstream(precious) << "mine";
  std::filesystem::create_symlink(precious, link);
  make();
  EXPECT_EQ(bytes_of(file + ".aside-1"), "mine");
  EXPECT_TRUE(std::filesystem::is_symlink(link + ".aside-1"));
  EXPECT_EQ(bytes_of(precious), "mine");
}

TEST_F(SmallSet, HittingHasABall) {
  options.scenes.set = "hitting";
  options.scenes.train = 1;
  options.scenes.test = 0;
  make();
  const DatasetReader reader(options.folder);
  const auto obstacles = reader.obstacles("hitting-00", 0, 5);
  ASSERT_EQ(obstacles[0].size(), 1u);
  EXPECT_GT(obstacles[4][0].radius, 0.05f);
  EXPECT_TRUE(check().problems.empty());
}

}  // namespace
}  // namespace pleat::dataset
