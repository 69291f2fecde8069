#include "common/mesh/polygons.hpp"

#include <gtest/gtest.h>

#include "common/mesh/charts.hpp"
#include "tests/support/errors.hpp"

namespace pleat {
namespace {

/// Two triangles of a square, each corner with a material coordinate of its own.
PolygonMesh square(const std::vector<float>& uv) {
  PolygonMesh mesh;
  mesh.positions = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
  const std::vector<std::uint32_t> sizes{3, 3}, vertices{0, 1, 2, 0, 2, 3};
  append_faces(
      mesh, {.file = "a.usda", .mesh = "Mesh 'a'", .sizes = sizes, .vertices = vertices, .vertex_count = 4, .uv = uv},
      0);
  return mesh;
}

TEST(Polygons, MaterialCoordinatesOfCornersAreOneAtAVertex) {
  const Topology joined = to_topology(square({0, 0, 1, 0, 1, 1, -0.0F, 0, 1, 1, 0, 1}), "a", MeshUse::kGarment);
  EXPECT_EQ(joined.uv.rows(), 4);
  EXPECT_EQ(joined.uv_faces(0, 0), joined.uv_faces(1, 0));
  EXPECT_EQ(face_charts(joined), (std::vector<std::uint32_t>{0, 0}));
  // Exporters round.
  EXPECT_EQ(to_topology(square({0, 0, 1, 0, 1, 1, 1e-7F, 0, 0.9999999F, 1, 0, 1}), "a", MeshUse::kGarment).uv.rows(),
            4);
}

TEST(Polygons, SeamsStaySeams) {
  const Topology apart = to_topology(square({0, 0, 1, 0, 1, 1, 5, 0, 6, 1, 5, 1}), "a", MeshUse::kGarment);
  EXPECT_EQ(apart.uv.rows(), 6);
  EXPECT_EQ(face_charts(apart), (std::vector<std::uint32_t>{0, 1}));
  // Two vertices at one place of the atlas, as of islands that lie over each other, are not one.
  const Topology over = to_topology(square({0, 0, 1, 0, 1, 1, 0.5F, 0, 0, 0, 0, 1}), "a", MeshUse::kGarment);
  EXPECT_EQ(over.uv.rows(), 6);
}

TEST(Polygons, FacesThatDoNotBelongTogetherAreRefused) {
  const auto refused = [](const FaceList& faces, const char* cause) {
    PolygonMesh mesh;
    const Error error = test::error_of([&] { append_faces(mesh, faces, 0); });
    EXPECT_NE(error.code(), ErrorCode::kInternal);
    EXPECT_EQ(std::string(error.what()).find("a.usda: Mesh 'a': "), 0u) << error.what();
    EXPECT_NE(std::string(error.what()).find(cause), std::string::npos) << error.what();
  };
  const std::vector<std::uint32_t> sizes{3}, big{4}, two{2}, vertices{0, 1, 2}, beyond{0, 1, 9}, same{0, 1, 1};
  const std::vector<float> uv{0, 0, 1, 0};
  FaceList list{.file = "a.usda", .mesh = "Mesh 'a'", .sizes = sizes, .vertices = vertices, .vertex_count = 3};
  list.sizes = big;
  refused(list, "has 4 corners");
  list.sizes = two;
  refused(list, "has 2 corners");
  list.sizes = {};
  refused(list, "3 corners, not 0");
  list.sizes = sizes;
  list.vertices = beyond;
  refused(list, "point 9 of 3");
  list.vertices = same;
  refused(list, "fewer than 3");
  list.vertices = vertices;
  list.uv = uv;
  refused(list, "no material coordinate 2");
  list.uv_indices = two;
  refused(list, "no material coordinate 2");
}

}  // namespace
}  // namespace pleat
