#include "common/mesh/triangle_intersection.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3f;

TEST(Orient3d, SignConvention) {
  const Vec3 a(0, 0, 0), b(1, 0, 0), c(0, 1, 0);
  EXPECT_EQ(orient3d(a, b, c, {0.2f, 0.2f, -1}), 1);
  EXPECT_EQ(orient3d(a, b, c, {0.2f, 0.2f, 1}), -1);
  EXPECT_EQ(orient3d(a, b, c, {0.7f, 0.1f, 0}), 0);
}

TEST(Orient3d, IsExactNextToThePlane) {
  // The plane x + y + z = 1.5 holds d exactly; one unit in the last place to either side decides.
  const Vec3 a(1.5f, 0, 0), b(0, 1.5f, 0), c(0, 0, 1.5f), d(0.5f, 0.25f, 0.75f);
  EXPECT_EQ(orient3d(a, b, c, d), 0);
  const float above = std::nextafter(0.75f, 1.f), below = std::nextafter(0.75f, 0.f);
  EXPECT_EQ(orient3d(a, b, c, {0.5f, 0.25f, above}), -orient3d(a, b, c, {0.5f, 0.25f, below}));
  EXPECT_NE(orient3d(a, b, c, {0.5f, 0.25f, above}), 0);
}

TEST(Orient3d, AgreesWithIntegersIncludingPermutations) {
  // Coordinates are small integers times a power of two plus a large offset that double differences still resolve.
  std::mt19937 random(1);
  std::uniform_int_distribution<int> uniform(-3, 3);
  for (int i = 0; i < 20000; ++i) {
    std::array<Eigen::Vector3i, 4> q;
    std::array<Vec3, 4> p;
    for (std::size_t k = 0; k < 4; ++k) {
      q[k] = {uniform(random), uniform(random), uniform(random)};
      p[k] = Vec3(1000, -4000, 500) + q[k].cast<float>() * 0x1p-10f;
    }
    const Eigen::Vector3i u = q[0] - q[3], v = q[1] - q[3], w = q[2] - q[3];
    const int determinant = u.x() * (v.y() * w.z() - v.z() * w.y()) - u.y() * (v.x() * w.z() - v.z() * w.x()) +
                            u.z() * (v.x() * w.y() - v.y() * w.x());
    const int sign = (determinant > 0) - (determinant < 0);
    ASSERT_EQ(orient3d(p[0], p[1], p[2], p[3]), sign);
    ASSERT_EQ(orient3d(p[1], p[0], p[2], p[3]), -sign);
    ASSERT_EQ(orient3d(p[3], p[0], p[1], p[2]), -sign);
  }
}

TEST(Orient3d, TinyAndHugeCoordinates) {
  const float tiny = 1e-30f, huge = 1e12f;
  EXPECT_EQ(orient3d({0, 0, 0}, {tiny, 0, 0}, {0, tiny, 0}, {0, 0, -tiny}), 1);
  EXPECT_EQ(orient3d({0, 0, 0}, {huge, 0, 0}, {0, huge, 0}, {huge, huge, tiny}), -1);
  EXPECT_EQ(orient3d({0, 0, tiny}, {huge, 0, tiny}, {0, huge, tiny}, {huge, huge, tiny}), 0);
}

TEST(Orient2d, CollinearPointsOfDifferentSizes) {
  EXPECT_EQ(orient2d({1e-10f, 1e-10f}, {1, 1}, {1e10f, 1e10f}), 0);
  EXPECT_EQ(orient2d({1e-10f, 1e-10f}, {1, 1}, {1e10f, std::nextafter(1e10f, 2e10f)}), 1);
}

struct PairCase {
  const char* name;
  Triangle3f a, b;
  bool expected;
};

class TrianglePairs : public testing::TestWithParam<PairCase> {};
const Triangle3f kBase{Vec3(0, 0, 0), Vec3(2, 0, 0), Vec3(0, 2, 0)};
INSTANTIATE_TEST_SUITE_P(
    All, TrianglePairs,
    testing::Values(
        PairCase{"crossing", kBase, {Vec3(0.5f, 0.5f, -1), Vec3(0.5f, 0.5f, 1), Vec3(3, 3, 0)}, true},
        PairCase{"apart", kBase, {Vec3(0, 0, 1), Vec3(2, 0, 1), Vec3(0, 2, 1)}, false},
        PairCase{"planes cross but triangles do not", kBase, {Vec3(3, 3, -1), Vec3(3, 3, 1), Vec3(4, 4, 0)}, false},
        PairCase{"a vertex touches the inside", kBase, {Vec3(0.5f, 0.5f, 0), Vec3(0, 0, 1), Vec3(1, 0, 1)}, true},
        PairCase{"a vertex touches an edge", kBase, {Vec3(1, 1, 0), Vec3(2, 2, 1), Vec3(2, 2, -1)}, true},
        PairCase{"a vertex just misses an edge",
                 kBase,
                 {Vec3(1, std::nextafter(1.f, 2.f), 0), Vec3(2, 2, 1), Vec3(2, 2, -1)},
                 false},
        PairCase{"a vertex touches a vertex", kBase, {Vec3(2, 0, 0), Vec3(3, 0, 1), Vec3(3, 0, -1)}, true},
        PairCase{"edges cross in space", kBase, {Vec3(1, -1, -1), Vec3(1, 1, 1), Vec3(1, -1, 1)}, true},
        PairCase{"coplanar, inside", kBase, {Vec3(0.2f, 0.2f, 0), Vec3(0.4f, 0.2f, 0), Vec3(0.2f, 0.4f, 0)}, true},
        PairCase{"coplanar, around", {Vec3(0.2f, 0.2f, 0), Vec3(0.4f, 0.2f, 0), Vec3(0.2f, 0.4f, 0)}, kBase, true},
        PairCase{"coplanar, star", kBase, {Vec3(-1, 1, 0), Vec3(3, 0.5f, 0), Vec3(3, 0.6f, 0)}, true},
        PairCase{"coplanar, edge on edge", kBase, {Vec3(0.5f, 0, 0), Vec3(1, 0, 0), Vec3(1, -1, 0)}, true},
        PairCase{"coplanar, apart", kBase, {Vec3(3, 0, 0), Vec3(5, 0, 0), Vec3(3, 2, 0)}, false},
        PairCase{"segment through", kBase, {Vec3(0.5f, 0.5f, -1), Vec3(0.5f, 0.5f, 0.5f), Vec3(0.5f, 0.5f, 1)}, true},
        PairCase{"segment beside", kBase, {Vec3(3, 0.5f, -1), Vec3(3, 0.5f, 0.5f), Vec3(3, 0.5f, 1)}, false},
        PairCase{"point on it", kBase, {Vec3(0.5f, 0.5f, 0), Vec3(0.5f, 0.5f, 0), Vec3(0.5f, 0.5f, 0)}, true},
        PairCase{"point in its plane beside it", kBase, {Vec3(2, 2, 0), Vec3(2, 2, 0), Vec3(2, 2, 0)}, false},
        PairCase{"two crossing segments",
                 {Vec3(0, 0, 0), Vec3(1, 1, 0), Vec3(2, 2, 0)},
                 {Vec3(0, 2, 0), Vec3(1, 1, 0), Vec3(2, 0, 0)},
                 true},
        PairCase{"two collinear segments apart",
                 {Vec3(0, 0, 0), Vec3(1, 1, 1), Vec3(2, 2, 2)},
                 {Vec3(3, 3, 3), Vec3(4, 4, 4), Vec3(5, 5, 5)},
                 false},
        PairCase{"two equal points",
                 {Vec3(1, 2, 3), Vec3(1, 2, 3), Vec3(1, 2, 3)},
                 {Vec3(1, 2, 3), Vec3(1, 2, 3), Vec3(1, 2, 3)},
                 true},
        PairCase{"two different points",
                 {Vec3(1, 2, 3), Vec3(1, 2, 3), Vec3(1, 2, 3)},
                 {Vec3(1, 2, 4), Vec3(1, 2, 4), Vec3(1, 2, 4)},
                 false}),
    [](const auto& test) {
      std::string name = test.param.name;
      std::replace_if(
          name.begin(), name.end(), [](char c) { return std::isalnum(static_cast<unsigned char>(c)) == 0; }, '_');
      return name;
    });

TEST_P(TrianglePairs, HaveTheExpectedAnswerInEveryOrder) {
  const PairCase& c = GetParam();
  std::array<std::size_t, 3> order{0, 1, 2};
  do {
    const Triangle3f a{c.a[order[0]], c.a[order[1]], c.a[order[2]]};
    EXPECT_EQ(triangles_intersect(a, c.b), c.expected);
    EXPECT_EQ(triangles_intersect(c.b, a), c.expected);
    for (int turn = 0; turn < 3; ++turn) {  // the three coordinate axes exchanged
      Triangle3f ta = a, tb = c.b;
      for (Vec3* p : {&ta[0], &ta[1], &ta[2], &tb[0], &tb[1], &tb[2]})
        *p = Vec3((*p)[(turn + 1) % 3], (*p)[(turn + 2) % 3], (*p)[turn]);
      EXPECT_EQ(triangles_intersect(ta, tb), c.expected);
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

// Five vertices, two faces with one or two common vertices.
bool adjacent(const std::array<Vec3, 5>& p, std::array<std::uint32_t, 3> a, std::array<std::uint32_t, 3> b) {
  Positions positions(5, 3);
  for (int i = 0; i < 5; ++i) positions.row(i) = p[static_cast<std::size_t>(i)];
  Faces faces(2, 3);
  faces << a[0], a[1], a[2], b[0], b[1], b[2];
  EXPECT_EQ(faces_intersect(positions, faces, 0, 1), faces_intersect(positions, faces, 1, 0));
  return faces_intersect(positions, faces, 0, 1);
}

TEST(AdjacentFaces, ACommonEdgeIntersectsOnlyWhenFoldedFlat) {
  const Vec3 u(0, 0, 0), v(1, 0, 0), a(0.3f, 1, 0);
  const auto folded = [&](const Vec3& b) { return adjacent({u, v, a, b, Vec3::Zero()}, {0, 1, 2}, {1, 0, 3}); };
  EXPECT_FALSE(folded({0.4f, -1, 0}));
  EXPECT_FALSE(folded({0.4f, 0.8f, 1e-20f}));
  EXPECT_FALSE(folded({0.4f, 0, 1}));
  EXPECT_TRUE(folded({0.4f, 0.8f, 0}));
  EXPECT_FALSE(folded({3, 0, 0}));  // without area, along the edge's line
}

TEST(AdjacentFaces, ACommonVertex) {
  const Vec3 v(0, 0, 0), a1(1, 0, 0), a2(0, 1, 0);
  const auto meet = [&](const Vec3& b1, const Vec3& b2) { return adjacent({v, a1, a2, b1, b2}, {0, 1, 2}, {0, 3, 4}); };
  EXPECT_FALSE(meet({-1, 0, 0}, {0, -1, 0}));            // coplanar, opposite
  EXPECT_FALSE(meet({-1, 0, 1}, {0, -1, 1}));            // only the vertex
  EXPECT_TRUE(meet({1, 1, 1}, {1, 1, -1}));              // the larger goes through
  EXPECT_TRUE(meet({0.1f, 0.1f, 1}, {0.1f, 0.1f, -1}));  // the smaller goes through
  EXPECT_TRUE(meet({0.5f, 0.6f, 0}, {3, 1, 0}));         // coplanar, overlapping
  EXPECT_TRUE(meet({2, 0, 0}, {0, 0, 1}));               // touch along an edge from the vertex
  EXPECT_FALSE(meet({-2, 0, 0}, {0, 0, 1}));
}

}  // namespace
}  // namespace pleat
