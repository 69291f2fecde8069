#include "common/mesh/animated_mesh.hpp"

#include <gtest/gtest.h>

#include "tests/support/errors.hpp"

namespace pleat {
namespace {

Topology square() {
  Topology mesh;
  mesh.rest_positions.resize(4, 3);
  mesh.rest_positions << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0;
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 2, 0, 2, 3;
  return mesh;
}

/// The square's triangles with vertex v numbered order[v].
PolygonMesh renumbered(const std::vector<std::uint32_t>& order) {
  PolygonMesh mesh;
  mesh.positions.assign(12, 0);
  const Topology topology = square();
  for (Eigen::Index i = 0; i < topology.faces.size(); ++i) {
    mesh.corners.push_back({order[topology.faces.data()[i]], PolygonMesh::kNoUv});
    if (i % 3 == 2) mesh.ends.push_back(mesh.corners.size());
  }
  mesh.places = {0, 1};
  return mesh;
}

TEST(AnimatedMesh, VerticesAreMatchedByTheCornersOfTriangles) {
  const std::vector<std::uint32_t> order{2, 0, 3, 1};
  EXPECT_EQ(match_vertices(renumbered(order), square(), "file"), order);
}

TEST(AnimatedMesh, OtherTrianglesLeaveTheOrderOfTheVertices) {
  const std::vector<std::uint32_t> as_they_are{0, 1, 2, 3};
  PolygonMesh mesh = renumbered({2, 0, 3, 1});
  mesh.corners[3].vertex = 0;  // two of ours would be one of theirs
  EXPECT_EQ(match_vertices(mesh, square(), "file"), as_they_are);
  PolygonMesh polygon = renumbered({2, 0, 3, 1});
  polygon.ends = {6};
  EXPECT_EQ(match_vertices(polygon, square(), "file"), as_they_are);
  mesh.positions.resize(15);
  const Error error = test::error_of([&] { match_vertices(mesh, square(), "file"); });
  EXPECT_STREQ(error.what(), "file has 5 vertices, the rest mesh 4");
}

TEST(AnimatedMesh, KeysBecomeEvenFrames) {
  const detail::FrameTimes rounded = detail::even_times({0, 0.0417F, 0.0833F, 0.125F, 0.125F}, "file");
  EXPECT_EQ(rounded.count, 4u);
  EXPECT_NEAR(rounded.step, 1.0 / 24, 1e-4);
  const detail::FrameTimes gap = detail::even_times({5, 2, 3}, "file");
  EXPECT_EQ(gap.count, 4u) << "4 is between two keys";
  EXPECT_EQ(gap.first, 2);
  EXPECT_EQ(detail::even_times({}, "file").count, 1u);
  EXPECT_EQ(detail::even_times({3, 3}, "file").count, 1u);
  EXPECT_EQ(test::error_of([] { detail::even_times({0, 1, 2.5}, "file"); }).code(), ErrorCode::kInvalidArgument);
  EXPECT_EQ(test::error_of([] { detail::even_times({0, 1, 5e6}, "file"); }).code(), ErrorCode::kResourceExhausted);
}

}  // namespace
}  // namespace pleat
