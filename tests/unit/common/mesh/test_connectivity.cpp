#include "common/mesh/connectivity.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "common/mesh/obj.hpp"

namespace pleat {
namespace {

// Everything that the struct promises, against the faces themselves.
void expect_consistent(Eigen::Index vertices, const Faces& faces) {
  const Connectivity c = build_connectivity(vertices, faces);
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> uses;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = faces(f, k), b = faces(f, (k + 1) % 3);
      ++uses[std::minmax(a, b)];
      const Edge& e = c.edges[c.face_edges[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)]];
      EXPECT_EQ(std::minmax(e.v0, e.v1), std::minmax(a, b));
      EXPECT_TRUE(e.f0 == f || e.f1 == f);
    }
  }
  EXPECT_EQ(c.edges.size(), uses.size());
  for (const Edge& e : c.edges) {
    EXPECT_EQ(uses[std::minmax(e.v0, e.v1)], e.f1 == kNone ? 1 : 2);
    EXPECT_EQ(e.f1 == kNone, e.opposite1 == kNone);
    bool forward = false;
    for (int k = 0; k < 3; ++k) forward |= faces(e.f0, k) == e.v0 && faces(e.f0, (k + 1) % 3) == e.v1;
    EXPECT_TRUE(forward);
    EXPECT_TRUE(e.opposite0 != e.v0 && e.opposite0 != e.v1);
    EXPECT_TRUE((faces.row(e.f0).array() == e.opposite0).any());
    if (e.f1 != kNone) {
      EXPECT_TRUE((faces.row(e.f1).array() == e.opposite1).any());
    }
  }
  for (std::uint32_t v = 0; v < vertices; ++v) {
    std::vector<std::uint32_t> at;
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if ((faces.row(f).array() == v).any()) at.push_back(static_cast<std::uint32_t>(f));
    }
    const std::vector<std::uint32_t> stored(c.vertex_faces.begin() + c.vertex_face_offsets[v],
                                            c.vertex_faces.begin() + c.vertex_face_offsets[v + 1]);
    EXPECT_EQ(stored, at);
  }
}

TEST(Connectivity, OfGarments) {
  for (const auto& [name, boundary] : {std::pair{"tablecloth", 96}, std::pair{"skirt", 175}}) {
    const Topology t = read_obj(std::filesystem::path("deploy/garments") / (std::string(name) + ".obj"));
    expect_consistent(t.vertex_count(), t.faces);
    const Connectivity c = build_connectivity(t.vertex_count(), t.faces);
    EXPECT_EQ(std::count_if(c.edges.begin(), c.edges.end(), [](const Edge& e) { return e.f1 == kNone; }), boundary);
    EXPECT_EQ(count_components(t.vertex_count(), t.faces), 1);
  }
}

TEST(Connectivity, VerticesThatTouchInAPoint) {
  // Two triangles with one common vertex and no common edge, and a vertex without faces.
  Faces faces(2, 3);
  faces << 0, 1, 2, 0, 3, 4;
  expect_consistent(6, faces);
  EXPECT_EQ(count_components(6, faces), 1);
}

TEST(Connectivity, BowTieOfManyFansAndClosedMeshes) {
  Faces bow(6, 3);  // three fans of two faces around vertex 0
  bow << 0, 1, 2, 0, 2, 3, 0, 4, 5, 0, 5, 6, 0, 7, 8, 0, 8, 9;
  expect_consistent(10, bow);
  Faces tetrahedron(4, 3);
  tetrahedron << 0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3;
  expect_consistent(4, tetrahedron);
  for (const Edge& e : build_connectivity(4, tetrahedron).edges) EXPECT_NE(e.f1, kNone);
}

TEST(Connectivity, CountsParts) {
  Faces faces(3, 3);
  faces << 0, 1, 2, 3, 4, 5, 6, 7, 8;
  EXPECT_EQ(count_components(20, faces), 3);
}

TEST(Connectivity, TheMeanEdgeIsThatOfTheFaces) {
  Topology t;
  EXPECT_EQ(mean_edge_length(t), 0);
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 3, 0, 0, 0, 4, 0, 3, 4, 0;
  t.faces.resize(2, 3);
  t.faces << 0, 1, 2, 1, 3, 2;
  EXPECT_FLOAT_EQ(static_cast<float>(mean_edge_length(t)), 4);
}

}  // namespace
}  // namespace pleat
