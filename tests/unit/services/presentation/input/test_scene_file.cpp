// Scene files: what is inlined, and that every error names its key.
#include "services/presentation/input/scene_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/scene_json.hpp"
#include "common/store/hdf5.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kMaterial =
    R"({"density": 0.2, "stretching": [[1,0,1,1],[1,0,1,1],[1,0,1,1],[1,0,1,1],[1,0,1,1],[1,0,1,1]],)"
    R"( "bending": [[1,1,1,1,1],[1,1,1,1,1],[1,1,1,1,1]]})";

class SceneFile : public testing::Test {
 protected:
  void SetUp() override {
    std::ofstream(folder_ / "cloth.obj") << "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"
                                            "f 1/1 2/2 3/3\nf 2/2 4/4 3/3\n";
    std::ofstream(folder_ / "material.json") << kMaterial;
    std::ofstream(folder_ / "ball.obj") << "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    scene_ = {{"name", "fall"}, {"garment_file", "cloth.obj"}, {"material_file", "material.json"}, {"frames", 3}};
  }

  v1::Scene parse(const json& scene) const { return parse_scene(scene.dump(), "fall.json", folder_); }

  void expect_error(const json& scene, const std::string& part, ErrorCode code = ErrorCode::kInvalidArgument) const {
    try {
      parse(scene);
      ADD_FAILURE() << "accepted " << scene.dump();
    } catch (const Error& error) {
      EXPECT_EQ(to_string(error.code()), to_string(code)) << error.what();
      EXPECT_THAT(error.what(), testing::HasSubstr(part));
      EXPECT_THAT(error.what(), testing::HasSubstr("fall.json"));
      EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr("\n")));
    }
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
  json scene_;
};

void write_point_cache(const fs::path& path, std::int32_t points, const std::vector<float>& values) {
  std::ofstream file(path, std::ios::binary);
  const std::int32_t version = 1, samples = static_cast<std::int32_t>(values.size()) / (3 * points);
  const float start = 0, rate = 1;
  file.write("POINTCACHE2\0", 12);
  for (const void* field :
       {static_cast<const void*>(&version), static_cast<const void*>(&points), static_cast<const void*>(&start),
        static_cast<const void*>(&rate), static_cast<const void*>(&samples)})
    file.write(static_cast<const char*>(field), 4);
  file.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(4 * values.size()));
}

TEST_F(SceneFile, InlinesAnimationsOfObstacles) {
  std::vector<float> values(2 * 4 * 3);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i);
  write_point_cache(folder_ / "body.pc2", 4, values);
  {
    const auto lock = hdf5::lock();
    hdf5::File file = hdf5::File::create(folder_ / "body.h5");
    file.write_array("/positions", H5T_NATIVE_FLOAT, {2, 4, 3}, values.data());
    file.write_array("/limbs/ends", H5T_NATIVE_FLOAT, {4, 2, 3}, values.data());
    values[17] = std::nanf("");
    file.write_array("/broken", H5T_NATIVE_FLOAT, {2, 4, 3}, values.data());
    values[17] = 17;
    file.close();
  }
  const auto with = [&](const std::string& file) {
    scene_["obstacles"] = json::array({{{"name", "body"}, {"mesh_file", "ball.obj"}, {"animation", {{"file", file}}}}});
    return scene_;
  };
  for (const char* file : {"body.pc2", "body.h5", "body.h5:/positions"}) {
    const v1::Scene scene = parse(with(file));
    const auto& positions = scene.obstacles(0).animation().positions();
    EXPECT_EQ(std::vector<float>(positions.begin(), positions.end()), values) << file;
    EXPECT_TRUE(scene.obstacles(0).animation().file().empty());
    EXPECT_THAT(scene_json(scene), testing::Not(testing::HasSubstr("positions")));
  }
  expect_error(with("none.pc2"), "obstacles[0].animation.file", ErrorCode::kNotFound);
  expect_error(with("body.h5:/limbs/ends"), "has 2 points, the obstacle 4");
  expect_error(with("body.h5:/broken"), "sample 1: vertex 1 is not finite");
  expect_error(with("body.h5:/nothing"), "no such array");
  expect_error(with("ball.obj"), "are read from");
  with("body.h5");
  scene_["obstacles"][0]["motion"] = json::array({{{"time_s", 1}}});
  expect_error(scene_, "motion and animation");

  json limbs = {{"name", "limbs"}, {"animation", {{"file", "body.h5:/limbs/ends"}}}};
  limbs["capsules"]["capsules"] = json::array({{{"a", {0, 0, 0}}, {"b", {0, 1, 0}}, {"radius", 0.1}}});
  scene_["obstacles"] = json::array({limbs});
  EXPECT_EQ(parse(scene_).obstacles(0).animation().positions_size(), 24);
}

class SceneWithABody : public SceneFile {
 protected:
  void SetUp() override {
    SceneFile::SetUp();
    fs::copy_file("deploy/bodies/young-female.glb", folder_ / "woman.glb");
    fs::copy_file("deploy/bodies/lambada.amc", folder_ / "dance.amc");
    fs::copy_file("deploy/bodies/lambada.asf", folder_ / "dance.asf");
    scene_["frames"] = 30;
    scene_["obstacles"] = json::array({{{"name", "woman"}, {"body", {{"file", "woman.glb"}}}}});
    body_ = &scene_["obstacles"][0]["body"];
  }
  json* body_ = nullptr;
};

TEST_F(SceneWithABody, ABodyAndItsMotionBecomeAMeshThatIsAnimated) {
  (*body_)["motion_file"] = "dance.amc";
  (*body_)["ease_frames"] = 5;
  std::vector<std::string> notes;
  const v1::Scene scene = parse_scene(scene_.dump(), "fall.json", folder_, {0, 1, &notes});
  const v1::Obstacle& woman = scene.obstacles(0);
  ASSERT_TRUE(woman.has_mesh());
  EXPECT_EQ(woman.mesh().rest_positions_size(), 3 * 13'380);
  EXPECT_EQ(woman.animation().sample_time_s(), 0.04);
  EXPECT_EQ(woman.animation().positions_size(), 32 * 3 * 13'380) << "what 30 frames need, and one more";
  EXPECT_THAT(notes, testing::Contains(testing::HasSubstr("'woman': ")));
  EXPECT_THAT(scene_json(scene), testing::Not(testing::HasSubstr("samples")));
  // The first sample is the rest pose; half a second later she is on her way.
  const auto& positions = woman.animation().positions();
  EXPECT_TRUE(std::equal(positions.begin(), positions.begin() + 3 * 13'380, woman.mesh().rest_positions().begin()));
  EXPECT_FALSE(std::equal(positions.begin(), positions.begin() + 3 * 13'380, positions.begin() + 12 * 3 * 13'380));
}

TEST_F(SceneWithABody, WithoutAMotionABodyStands) {
  const v1::Scene scene = parse(scene_);
  EXPECT_TRUE(scene.obstacles(0).has_mesh());
  EXPECT_FALSE(scene.obstacles(0).has_animation());
}

TEST_F(SceneWithABody, WhatIsWrongWithABodyIsSaidInOneLine) {
  const json good = scene_;
  const auto with = [&](const char* key, const json& value) {
    json scene = good;
    scene["obstacles"][0]["body"][key] = value;
    return scene;
  };
  expect_error(with("file", "nobody.glb"), "obstacles[0].body.file", ErrorCode::kNotFound);
  expect_error(with("file", ""), "obstacles[0].body.file is missing");
  expect_error(with("file", "ball.obj"), "ball.obj");
  expect_error(with("motion_file", "none.bvh"), "obstacles[0].body.motion_file", ErrorCode::kNotFound);
  expect_error(with("motion_file", "woman.glb"), "woman.glb");
  expect_error(with("skeleton_file", "none.asf"), "obstacles[0].body.skeleton_file", ErrorCode::kNotFound);
  expect_error(with("frame_time_s", 0), "time between frames must be positive");
  expect_error(with("start_s", -1), "must not be negative");
  expect_error(with("end_s", 0), "must be after its start");
  expect_error(with("ease_frames", 1'000'000), "0 to 10000");
  expect_error(with("skinning", "SKINNING_RUBBER"), "skinning");
  json moved = good;
  moved["obstacles"][0]["motion"] = json::array({{{"time_s", 1}}});
  expect_error(moved, "moves by its motion_file");
  json animated = good;
  animated["obstacles"][0]["animation"] = {{"file", "body.pc2"}};
  expect_error(animated, "moves by its motion_file");
}

TEST_F(SceneFile, SeveralGarmentsAreOneMesh) {
  scene_["further_garment_files"] = {"cloth.obj", "cloth.obj"};
  const v1::Scene scene = parse(scene_);
  EXPECT_TRUE(scene.further_garment_files().empty());
  const Topology joined = from_message(scene.garment_mesh());
  EXPECT_EQ(joined.vertex_count(), 12);
  EXPECT_EQ(joined.face_count(), 6);
  EXPECT_NO_THROW(validate_material_coordinates(joined, "joined"));
  for (int piece = 0; piece < 3; ++piece) {
    EXPECT_TRUE((joined.faces.middleRows(2 * piece, 2).array() - 4u * static_cast<unsigned>(piece) ==
                 joined.faces.topRows(2).array())
                    .all());
    EXPECT_EQ(joined.rest_positions.middleRows(4 * piece, 4), joined.rest_positions.topRows(4));
    // Beside each other in the material, as large as before.
    const auto u = joined.uv.middleRows(4 * piece, 4).col(0);
    EXPECT_NEAR(u.maxCoeff() - u.minCoeff(), 1, 1e-6);
    if (piece > 0) {
      EXPECT_GT(u.minCoeff(), joined.uv.topRows(4 * piece).col(0).maxCoeff());
    }
  }
  ASSERT_EQ(scene.garment_layers_size(), 3);
  for (const v1::GarmentLayer& layer : scene.garment_layers()) {
    EXPECT_EQ(layer.name(), "cloth");
    EXPECT_EQ(layer.faces(), 2u);
  }
  scene_["further_garment_files"] = {"cloth.obj", "hat.obj"};
  expect_error(scene_, "further_garment_files[1]", ErrorCode::kNotFound);
}

TEST_F(SceneFile, TakesAnIsotropicMaterialInPlaceOfAFile) {
  scene_.erase("material_file");
  scene_["isotropic"] = {{"density", 300}, {"youngsModulus", 1e6}, {"poissonsRatio", 0.3}, {"thickness", 5e-4}};
  EXPECT_EQ(parse(scene_).isotropic().youngs_modulus(), 1e6);
  const auto refused = [&](const char* key, double value, const std::string& part) {
    json bad = scene_;
    bad["isotropic"][key] = value;
    expect_error(bad, part);
  };
  refused("density", -1, "isotropic.density must be positive");
  refused("youngsModulus", 0, "isotropic.youngs_modulus must be positive");
  refused("poissonsRatio", 0.6, "isotropic.poissons_ratio");
  refused("thickness", 0, "isotropic.thickness must be positive");
}

TEST_F(SceneFile, ChecksCapsules) {
  const auto with = [&](const json& capsule) {
    json limbs = {{"name", "limbs"}};
    limbs["capsules"]["capsules"] = json::array({capsule});
    scene_["obstacles"] = json::array({limbs});
    return scene_;
  };
  EXPECT_EQ(parse(with({{"a", {0, 0, 0}}, {"b", {0, 1, 0}}, {"radius", 0.1}})).obstacles(0).capsules().capsules_size(),
            1);
  expect_error(with({{"a", {0, 0, 0}}, {"radius", 0.1}}), "capsules[0].b");
  expect_error(with({{"a", {0, 0}}, {"b", {0, 1, 0}}, {"radius", 0.1}}), "capsules[0].a");
  expect_error(with({{"a", {0, 0, 0}}, {"b", {0, 1, 0}}, {"radius", 0}}), "capsules[0].radius");
}

TEST_F(SceneFile, InlinesGarmentMaterialAndObstacleMesh) {
  scene_["obstacles"] = json::array({{{"name", "ball"}, {"mesh_file", "ball.obj"}}});
  const v1::Scene scene = parse(scene_);
  EXPECT_EQ(scene.garment_mesh().rest_positions_size(), 12);
  EXPECT_EQ(scene.garment_mesh().uv_faces_size(), 6);
  EXPECT_EQ(scene.garment_mesh().hash().size(), 16u);
  EXPECT_EQ(scene.material_json(), kMaterial);
  EXPECT_EQ(scene.obstacles(0).mesh().faces_size(), 12);
  EXPECT_EQ(scene.frames(), 3u);
}

TEST_F(SceneFile, TakesBothSpellingsOfKeys) {
  scene_["stepsPerFrame"] = 5;
  EXPECT_EQ(parse(scene_).steps_per_frame(), 5u);
  scene_.erase("stepsPerFrame");
  scene_["steps_per_frame"] = 6;
  EXPECT_EQ(parse(scene_).steps_per_frame(), 6u);
}

TEST_F(SceneFile, IsReadRelativeToItself) {
  std::ofstream(folder_ / "fall.json") << scene_.dump();
  EXPECT_EQ(read_scene_file(folder_ / "fall.json").garment_mesh().faces_size(), 6);
}

TEST_F(SceneFile, NamesUnknownKeys) {
  json scene = scene_;
  scene["gravty"] = json::array({0, -9.81, 0});
  expect_error(scene, "unknown key 'gravty'");
  scene = scene_;
  scene["handles"] = json::array({{{"vertices", {0}}, {"stifness", 3}}});
  expect_error(scene, "stifness");
}

TEST_F(SceneFile, RefusesNamesAndKeysWithoutEnd) {
  json scene = scene_;
  scene["name"] = std::string(100'000, 'a');
  expect_error(scene, "name has 100000 characters");
  scene["name"] = std::string(100'000, '.');
  expect_error(scene, "must be letters");
  scene = scene_;
  scene[std::string(100'000, 'k')] = 1;
  expect_error(scene, "kkk");
}

TEST_F(SceneFile, NamesMissingFiles) {
  json scene = scene_;
  scene["garment_file"] = "none.obj";
  expect_error(scene, "none.obj", ErrorCode::kNotFound);
  scene = scene_;
  scene["material_file"] = "none.json";
  expect_error(scene, "none.json", ErrorCode::kNotFound);
  scene = scene_;
  scene["obstacles"] = json::array({{{"name", "ball"}, {"mesh_file", "none.obj"}}});
  expect_error(scene, "obstacles[0].mesh_file", ErrorCode::kNotFound);
  EXPECT_THROW(read_scene_file(folder_ / "none.json"), Error);
}

TEST_F(SceneFile, NamesMissingKeys) {
  for (const char* key : {"garment_file", "material_file", "frames", "name"}) {
    json scene = scene_;
    scene.erase(key);
    expect_error(scene, key);
  }
}

TEST_F(SceneFile, NamesWrongValues) {
  const std::vector<std::tuple<const char*, json, const char*>> cases = {
      {"frames", 0, "frames must be positive"},
      {"frames", -3, "frames"},
      {"steps_per_frame", 0, "steps_per_frame must be positive"},
      {"steps_per_frame", -1, "-1"},
      {"stepsPerFrame", 0, "steps_per_frame must be positive"},
      {"frame_time_s", 0, "frame_time_s must be positive"},
      {"frame_time_s", -0.04, "frame_time_s must be positive"},
      {"frame_time_s", "soon", "soon"},
      {"gravity", {0, -9.81}, "gravity needs 3 values, has 2"},
      {"name", "a b", "name 'a b'"},
      {"name", "../x", "name '../x'"},
      {"subdivision_rounds", 9, "subdivision_rounds"},
      {"handles", {{{"vertices", {0, 4}}}}, "handles[0].vertices[1]: vertex 4 does not exist, the garment has 4"},
      {"handles", {{{"hard", true}}}, "handles[0].vertices is empty"},
      {"handles", {{{"vertices", {0}}, {"stiffness", -1}}}, "handles[0].stiffness"},
      {"handles", {{{"vertices", {0}}, {"start_s", 2}, {"end_s", 1}}}, "handles[0].end_s"},
      {"handles", {{{"vertices", {0}}, {"motion", {{{"time_s", 1}}, {{"time_s", 1}}}}}}, "handles[0].motion[1].time_s"},
      {"obstacles", {{{"name", "ball"}}}, "obstacles[0]"},
      {"obstacles", {{{"name", "ball"}, {"sphere", {{"center", {0, 0, 0}}, {"radius", 0}}}}}, "sphere.radius"},
      {"obstacles", {{{"name", "ball"}, {"sphere", {{"center", {0, 0}}, {"radius", 1}}}}}, "sphere.center"},
      {"obstacles", {{{"name", ""}, {"sphere", {{"radius", 1}}}}}, "obstacles[0].name"},
      {"obstacles",
       {{{"name", "a"}, {"sphere", {{"radius", 1}}}}, {{"name", "a"}, {"sphere", {{"radius", 1}}}}},
       "obstacles[1].name 'a' is taken"},
  };
  for (const auto& [key, value, part] : cases) {
    SCOPED_TRACE(key);
    json scene = scene_;
    scene[key] = value;
    expect_error(scene, part);
  }
}

TEST_F(SceneFile, RefusesWhatIsNoJsonObject) {
  for (const char* text : {"", "[1]", "{\"name\": }", "garbage"}) {
    try {
      parse_scene(text, "fall.json", folder_);
      ADD_FAILURE() << "accepted " << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(error.what(), testing::HasSubstr("fall.json"));
    }
  }
}

TEST_F(SceneFile, RefusesAGarmentWithoutMaterialCoordinates) {
  std::ofstream(folder_ / "cloth.obj") << "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 3 2\n";
  try {
    parse(scene_);
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("cloth.obj"));
  }
}

TEST_F(SceneFile, RefusesAMaterialByTheNameOfItsFile) {
  for (const char* text :
       {"density = 1", R"({"density": 0.2})", R"({"density": 0.2, "stretching": [[1]], "bending": []})"}) {
    std::ofstream(folder_ / "material.json") << text;
    try {
      parse(scene_);
      ADD_FAILURE() << "accepted " << text;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr("material.json"));
    }
  }
}

TEST_F(SceneFile, RecordsTheSceneWithoutMeshes) {
  scene_["obstacles"] = json::array({{{"name", "ball"}, {"mesh_file", "ball.obj"}}});
  const json record = json::parse(scene_json(parse(scene_)));
  EXPECT_EQ(record.at("name"), "fall");
  EXPECT_FALSE(record.contains("garment_mesh"));
  EXPECT_FALSE(record.at("obstacles").at(0).contains("mesh"));
}

}  // namespace
}  // namespace pleat::presentation
