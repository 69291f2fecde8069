#include "common/client/adapter/adapter.hpp"

#include <gtest/gtest.h>

namespace pleat::client {
namespace {

TEST(Adapter, MeshesKeepTheirOrder) {
  const Mesh mesh{{0, 1, 2, 3, 4, 5, 6, 7, 8}, {2, 0, 1}, {0, 1, 2, 3, 4, 5, 6, 7}, {3, 1, 2}};
  const Topology topology = to_topology(mesh);
  EXPECT_EQ(topology.rest_positions.row(1), Eigen::RowVector3f(3, 4, 5));
  EXPECT_EQ(topology.uv.rows(), 4);
  EXPECT_EQ(topology.uv_faces(0, 0), 3u);
  const Mesh again = from_topology(topology);
  EXPECT_EQ(again.positions, mesh.positions);
  EXPECT_EQ(again.faces, mesh.faces);
  EXPECT_EQ(again.uv, mesh.uv);
  EXPECT_EQ(again.uv_faces, mesh.uv_faces);
}

TEST(Adapter, EveryKindOfObstacle) {
  const std::vector<ObstacleFrame> frames = {
      {.name = "ball", .center = {1, 2, 3}, .radius = 4, .positions = {}, .capsule_ends = {}, .capsule_radii = {}},
      {.name = "arm",
       .center = {},
       .radius = 0,
       .positions = {},
       .capsule_ends = {0, 0, 0, 1, 1, 1},
       .capsule_radii = {0.5f}},
      {.name = "box", .center = {}, .radius = 0, .positions = {1, 2, 3}, .capsule_ends = {}, .capsule_radii = {}}};
  const std::vector<pleat::ObstacleFrame> own = to_obstacles(frames);
  ASSERT_EQ(own.size(), 3u);
  EXPECT_EQ(own[0].center, Eigen::Vector3f(1, 2, 3));
  EXPECT_EQ(own[1].capsule_ends.rows(), 2);
  const std::vector<ObstacleFrame> again = from_obstacles(own);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(again[i].name, frames[i].name);
    EXPECT_EQ(again[i].center, frames[i].center);
    EXPECT_EQ(again[i].radius, frames[i].radius);
    EXPECT_EQ(again[i].positions, frames[i].positions);
    EXPECT_EQ(again[i].capsule_ends, frames[i].capsule_ends);
    EXPECT_EQ(again[i].capsule_radii, frames[i].capsule_radii);
  }
  const std::vector<ObstacleShape> shapes = {{"ball", {}, 0}, {"arm", {}, 1}, {"box", {0, 1, 2}, 0}};
  const std::vector<ObstacleShape> shapes_again = from_shapes(to_shapes(shapes));
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(shapes_again[i].name, shapes[i].name);
    EXPECT_EQ(shapes_again[i].faces, shapes[i].faces);
    EXPECT_EQ(shapes_again[i].capsules, shapes[i].capsules);
  }
}

}  // namespace
}  // namespace pleat::client
