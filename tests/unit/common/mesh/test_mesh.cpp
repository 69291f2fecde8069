#include "common/mesh/mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "common/base/error.hpp"

namespace pleat {
namespace {

using testing::HasSubstr;

// Two triangles that make a unit square in the plane z = 0.
Topology square() {
  Topology t;
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0;
  t.faces.resize(2, 3);
  t.faces << 0, 1, 2, 0, 2, 3;
  t.uv = t.rest_positions.leftCols(2);
  t.uv_faces = t.faces;
  return t;
}

void expect_refused(const std::function<void(Topology&)>& spoil, const std::string& culprit) {
  Topology t = square();
  spoil(t);
  try {
    validate_topology(t, "cloth.obj");
    FAIL() << "accepted: " << culprit;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
    EXPECT_THAT(e.what(), HasSubstr("cloth.obj"));
    EXPECT_THAT(e.what(), HasSubstr(culprit));
  }
}

TEST(Mesh, AcceptsASquare) {
  EXPECT_NO_THROW(validate_topology(square(), "square"));
  EXPECT_NO_THROW(validate_material_coordinates(square(), "square"));
}

TEST(Mesh, RefusesUnusableTopologies) {
  expect_refused([](Topology& t) { t.faces.resize(0, 3); }, "no vertices or no faces");
  expect_refused([](Topology& t) { t.rest_positions(2, 1) = std::numeric_limits<float>::quiet_NaN(); }, "vertex 2");
  expect_refused([](Topology& t) { t.uv(3, 0) = std::numeric_limits<float>::infinity(); }, "coordinate 3");
  expect_refused([](Topology& t) { t.faces(1, 2) = 4; }, "index 4");
  expect_refused([](Topology& t) { t.uv_faces(0, 0) = 99; }, "index 99");
  expect_refused([](Topology& t) { t.faces(0, 1) = 0; }, "repeats vertex 0");
  expect_refused([](Topology& t) { t.uv_faces.conservativeResize(1, 3); }, "material coordinates");
  expect_refused([](Topology& t) { t.uv.resize(0, 2); }, "material coordinates");
  expect_refused(
      [](Topology& t) {
        t.faces.row(1) << 2, 0, 3;
        t.faces.row(0) << 2, 0, 1;
      },
      "oriented differently");
  expect_refused(
      [](Topology& t) {
        t.rest_positions.conservativeResize(5, 3);
        t.rest_positions.row(4) << 0, 0, 1;
        t.faces.conservativeResize(3, 3);
        t.faces.row(2) << 0, 2, 4;
        t.uv_faces = t.faces.cwiseMin(3u);
      },
      "not manifold");
}

TEST(Mesh, RefusesUnusableMaterialCoordinates) {
  const auto expect = [](const std::function<void(Topology&)>& spoil, const std::string& culprit) {
    Topology t = square();
    spoil(t);
    try {
      validate_material_coordinates(t, "cloth.obj");
      FAIL() << "accepted: " << culprit;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::kInvalidArgument);
      EXPECT_THAT(e.what(), HasSubstr(culprit));
    }
  };
  expect([](Topology& t) { t.uv.resize(0, 2), t.uv_faces.resize(0, 3); }, "no material coordinates");
  expect([](Topology& t) { t.uv.row(3) = t.uv.row(2); }, "face 1 has no area");
  expect([](Topology& t) { t.uv.row(3) << 1, 0.2f; }, "folded");
  expect([](Topology& t) { t.uv.col(0) *= -1; }, "mirrored");
}

TEST(Mesh, NormalsAreAreaWeightedUnitVectors) {
  Topology t = square();
  t.rest_positions.conservativeResize(5, 3);
  t.rest_positions.row(4) << 9, 9, 9;  // no face uses it
  const Positions n = vertex_normals(t.rest_positions, t.faces);
  for (int v = 0; v < 4; ++v) EXPECT_LT((n.row(v) - Eigen::RowVector3f(0, 0, 1)).norm(), 1e-6f);
  EXPECT_EQ(n.row(4), Eigen::RowVector3f(0, 1, 0));

  // A big face towards +z and a small one towards +x meet in vertex 0.
  Positions x(5, 3);
  x << 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 1, 0, 0, 0, 1;
  Faces f(2, 3);
  f << 0, 1, 2, 0, 3, 4;
  const Eigen::RowVector3f expected = Eigen::RowVector3f(1, 0, 4).normalized();
  EXPECT_LT((vertex_normals(x, f).row(0) - expected).norm(), 1e-6f);
}

TEST(Mesh, HashChangesWithEveryPart) {
  const std::string hash = topology_hash(square());
  EXPECT_EQ(hash.size(), 16u);
  EXPECT_EQ(hash, topology_hash(square()));
  Topology t = square();
  t.rest_positions(0, 0) = 1e-20f;
  EXPECT_NE(hash, topology_hash(t));
  t = square();
  t.uv(0, 0) = 1e-20f;
  EXPECT_NE(hash, topology_hash(t));
  t = square();
  t.faces.row(0) << 1, 2, 0;
  EXPECT_NE(hash, topology_hash(t));
}

}  // namespace
}  // namespace pleat
