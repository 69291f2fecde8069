#include "services/presentation/live/job_view.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <nlohmann/json.hpp>

namespace pleat::presentation {
namespace {

nlohmann::json about_of(const std::string& bytes) {
  std::uint32_t size = 0;
  std::memcpy(&size, bytes.data(), sizeof size);
  return nlohmann::json::parse(bytes.substr(4, size));
}

std::map<std::string, std::size_t> lengths_of(const nlohmann::json& about) {
  std::map<std::string, std::size_t> lengths;
  for (const auto& entry : about["arrays"]) lengths[entry["name"]] = entry["length"];
  return lengths;
}

client::JobMeshes meshes() {
  client::JobMeshes all;
  all.coarse = {{0, 0, 0, 1, 0, 0, 0, 0, 1}, {0, 1, 2}, {}, {}};
  all.fine = all.coarse;
  all.obstacles = {{"ball", {}, 0}, {"body", {0, 1, 2, 0, 2, 3}, 0}, {"arm", {}, 2}};
  return all;
}

TEST(JobView, MeshesHaveTheFacesOfWhatIsNoSphere) {
  const auto about = about_of(pack_meshes(meshes()));
  EXPECT_EQ(about["coarse_vertices"], 3);
  EXPECT_EQ(about["obstacles"][2]["name"], "arm");
  const auto lengths = lengths_of(about);
  EXPECT_EQ(lengths.at("fine_faces"), 3U);
  EXPECT_EQ(lengths.count("obstacle_faces_0"), 0U);
  EXPECT_EQ(lengths.at("obstacle_faces_1"), 6U);
  EXPECT_GT(lengths.at("obstacle_faces_2"), 100U);
}

TEST(JobView, ObstaclesAreFoundByTheirNamesAndMayBeMissing) {
  client::EnhancedFrame frame;
  frame.index = 5;
  frame.positions.assign(9, 1);
  frame.coarse.assign(9, 2);
  frame.report.self_intersections_after = 4;
  frame.stage_times = {{"fold", 2.5}};
  client::ObstacleFrame arm, ball;
  arm.name = "arm";
  arm.capsule_ends.assign(12, 0.5F);
  arm.capsule_radii = {0.1F, 0.2F};
  ball.name = "ball";
  ball.center = {1, 2, 3};
  ball.radius = 0.5F;
  frame.obstacles = {arm, ball};
  const auto about = about_of(pack_frame(frame, meshes()));
  EXPECT_EQ(about["index"], 5);
  EXPECT_EQ(about["self_intersections"], 4);
  EXPECT_EQ(about["stages"][0]["ms"], 2.5);
  EXPECT_EQ(about["obstacles"][0]["radius"], 0.5);
  EXPECT_EQ(about["obstacles"][0]["center"][2], 3.0);
  EXPECT_TRUE(about["obstacles"][1].empty());
  const auto lengths = lengths_of(about);
  EXPECT_EQ(lengths.at("fine"), 9U);
  EXPECT_EQ(lengths.count("obstacle_1"), 0U);
  EXPECT_GT(lengths.at("obstacle_2"), 100U);
  // A capsule's surface has as many vertices as its faces name.
  const auto faces = about_of(pack_meshes(meshes()));
  EXPECT_GT(lengths_of(faces).at("obstacle_faces_2"), lengths.at("obstacle_2"));
}

TEST(JobView, AFailedFrameSaysWhyAndHasNoArrays) {
  client::EnhancedFrame frame;
  frame.index = 2;
  frame.error.emplace(ErrorCode::kInvalidArgument, "frame 2: positions");
  const auto about = about_of(pack_frame(frame, meshes()));
  EXPECT_EQ(about["error"], "frame 2: positions");
  EXPECT_TRUE(about["arrays"].empty());
}

}  // namespace
}  // namespace pleat::presentation
