// Thousands of triangle pairs, judged by CGAL with exact arithmetic.
#include <CGAL/Exact_predicates_exact_constructions_kernel.h>
#include <CGAL/intersections.h>
#include <gtest/gtest.h>

#include <random>
#include <variant>

#include "common/mesh/triangle_intersection.hpp"

namespace pleat {
namespace {

using Kernel = CGAL::Exact_predicates_exact_constructions_kernel;
using Vec3 = Eigen::Vector3f;

Kernel::Point_3 point(const Vec3& p) {
  return {static_cast<double>(p.x()), static_cast<double>(p.y()), static_cast<double>(p.z())};
}
Kernel::Triangle_3 triangle(const Triangle3f& t) { return {point(t[0]), point(t[1]), point(t[2])}; }

// Points whose coincidences grow with `kind`: free floats; a grid of 5; a grid of 4 with z = 0 half of the time; floats
// within a few units in the last place of a plane.
Vec3 random_point(std::mt19937& random, int kind) {
  std::uniform_real_distribution<float> uniform(0, 1);
  std::uniform_int_distribution<int> five(0, 4), four(0, 3), ulp(-2, 2);
  switch (kind) {
    case 0:
      return {uniform(random), uniform(random), uniform(random)};
    case 1:
      return {0.1f * static_cast<float>(five(random)), 0.1f * static_cast<float>(five(random)),
              0.1f * static_cast<float>(five(random))};
    case 2:
      return {static_cast<float>(four(random)), static_cast<float>(four(random)),
              random() % 2 == 0 ? 0.f : static_cast<float>(four(random))};
    default: {
      const float x = uniform(random), y = uniform(random);
      return {x, y, 0.3f * x - 0.7f * y + 1 + 6e-8f * static_cast<float>(ulp(random))};
    }
  }
}

class AgainstCgal : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Kinds, AgainstCgal, testing::Range(0, 4));

TEST_P(AgainstCgal, DisjointPairs) {
  std::mt19937 random(11 + static_cast<unsigned>(GetParam()));
  int intersecting = 0, judged = 0;
  for (int i = 0; i < 6000; ++i) {
    Triangle3f a, b;
    for (Vec3* p : {&a[0], &a[1], &a[2], &b[0], &b[1], &b[2]}) *p = random_point(random, GetParam());
    if (triangle(a).is_degenerate() || triangle(b).is_degenerate()) continue;
    const bool expected = CGAL::do_intersect(triangle(a), triangle(b));
    ASSERT_EQ(triangles_intersect(a, b), expected) << "pair " << i;
    ASSERT_EQ(triangles_intersect(b, a), expected) << "pair " << i;
    intersecting += expected;
    ++judged;
  }
  EXPECT_GT(intersecting, 300);
  EXPECT_GT(judged - intersecting, 300);
}

TEST_P(AgainstCgal, SegmentsAndTriangles) {
  std::mt19937 random(21 + static_cast<unsigned>(GetParam()));
  for (int i = 0; i < 4000; ++i) {
    Triangle3f t;
    Vec3 p, q;
    for (Vec3* x : {&t[0], &t[1], &t[2], &p, &q}) *x = random_point(random, GetParam());
    if (triangle(t).is_degenerate() || p == q) continue;
    ASSERT_EQ(segment_intersects_triangle(p, q, t),
              CGAL::do_intersect(Kernel::Segment_3(point(p), point(q)), triangle(t)))
        << i;
  }
}

// The common set of two faces, constructed exactly: more than the common vertex or edge?
bool more_than_common(const Triangle3f& a, const Triangle3f& b, int common) {
  const auto result = CGAL::intersection(triangle(a), triangle(b));
  if (!result) return false;
  if (boost::get<Kernel::Point_3>(&*result) != nullptr) return false;
  if (const auto* segment = boost::get<Kernel::Segment_3>(&*result)) {
    if (common == 1) return true;
    const Kernel::Segment_3 edge(point(a[0]), point(a[1]));
    return *segment != edge && *segment != edge.opposite();
  }
  return true;
}

TEST_P(AgainstCgal, FacesWithCommonVertices) {
  std::mt19937 random(31 + static_cast<unsigned>(GetParam()));
  for (const int common : {1, 2}) {
    int intersecting = 0, judged = 0;
    for (int i = 0; i < 3000; ++i) {
      Positions positions(5, 3);
      for (int v = 0; v < 5; ++v) positions.row(v) = random_point(random, GetParam());
      Faces faces(2, 3);
      if (common == 1) {
        faces << 0, 1, 2, 0, 3, 4;
      } else {
        faces << 0, 1, 2, 0, 1, 3;
      }
      Triangle3f a, b;
      for (int k = 0; k < 3; ++k) {
        a[static_cast<std::size_t>(k)] = positions.row(faces(0, k));
        b[static_cast<std::size_t>(k)] = positions.row(faces(1, k));
      }
      if (triangle(a).is_degenerate() || triangle(b).is_degenerate()) continue;
      const bool expected = more_than_common(a, b, common);
      ASSERT_EQ(faces_intersect(positions, faces, 0, 1), expected) << "common " << common << " pair " << i;
      ASSERT_EQ(faces_intersect(positions, faces, 1, 0), expected);
      intersecting += expected;
      ++judged;
    }
    EXPECT_GT(judged, 1000);
    if (common == 1 || GetParam() == 2) {
      EXPECT_GT(intersecting, 20);
    }
  }
}

}  // namespace
}  // namespace pleat
