#include "common/mesh/ccd.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <random>

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;
using Quad = std::array<Vec3, 4>;

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double in(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vec3 point(double size) { return {in(-size, size), in(-size, size), in(-size, size)}; }
  Quad quad(double size) { return {point(size), point(size), point(size), point(size)}; }

 private:
  std::mt19937 engine_;
};

Quad at(const Quad& start, const Quad& end, double t) {
  Quad x;
  for (std::size_t i = 0; i < 4; ++i) x[i] = start[i] + t * (end[i] - start[i]);
  return x;
}

// Signed volume of the four points: it changes sign where a vertex passes the plane of a face, or an edge another.
double volume(const Quad& x) { return (x[1] - x[0]).dot((x[2] - x[0]).cross(x[3] - x[0])); }

// Brute force: does the pair meet at one of many times? Finds the sign changes of the volume between samples, bisects,
// and looks whether the primitives touch there.
template <typename Distance>
bool meets(const Quad& start, const Quad& end, const Distance& distance) {
  constexpr int kSamples = 64;
  double before = volume(start);
  for (int i = 1; i <= kSamples; ++i) {
    const double t1 = double(i) / kSamples;
    const double after = volume(at(start, end, t1));
    if (before * after <= 0) {
      double low = double(i - 1) / kSamples, high = t1;
      for (int k = 0; k < 60; ++k) {
        const double middle = (low + high) / 2;
        (volume(at(start, end, middle)) * before > 0 ? low : high) = middle;
      }
      if (distance(at(start, end, high)) < 1e-9) return true;
    }
    before = after;
  }
  return false;
}

double vertex_face_distance(const Quad& x) {
  return std::sqrt(closest_vertex_face(x[0], x[1], x[2], x[3]).squared_distance);
}
double edge_edge_distance(const Quad& x) {
  return std::sqrt(closest_edge_edge(x[0], x[1], x[2], x[3]).squared_distance);
}

struct Counts {
  int hits = 0, misses = 0, false_negatives = 0, early = 0;
};

template <typename Ccd, typename Distance>
Counts compare(unsigned seed, int cases, const Ccd& ccd, const Distance& distance) {
  Random random(seed);
  Counts counts;
  for (int i = 0; i < cases; ++i) {
    Quad start = random.quad(1), end;
    const double speed = i % 3 == 0 ? 0.2 : 2.0;
    for (std::size_t k = 0; k < 4; ++k) end[k] = start[k] + random.point(speed);
    if (i % 5 == 0) {  // a common motion must not matter
      const Vec3 shift = random.point(50);
      for (Vec3& x : end) x += shift;
    }
    if (i % 7 == 0) {  // planar motion
      for (std::size_t k = 0; k < 4; ++k) start[k].z() = end[k].z() = 0;
    }
    const auto collision = ccd(start, end, CcdOptions{});
    const bool truth = i % 7 == 0 ? false : meets(start, end, distance);
    if (truth && !collision) ++counts.false_negatives;
    if (collision) {
      ++counts.hits;
      // Reported times are safe: until then the pair never touched.
      for (int s = 0; s <= 8; ++s) counts.early += distance(at(start, end, collision->time * s / 8)) <= 0 && i % 7 != 0;
    } else {
      ++counts.misses;
      // And without a report it never touches.
      for (int s = 0; s <= 32; ++s) counts.false_negatives += distance(at(start, end, s / 32.0)) <= 0;
    }
  }
  return counts;
}

TEST(Ccd, VertexFaceMissesNothing) {
  const Counts counts = compare(1, 30000, vertex_face_ccd, vertex_face_distance);
  EXPECT_EQ(counts.false_negatives, 0);
  EXPECT_EQ(counts.early, 0);
  EXPECT_GT(counts.hits, 1000);
  EXPECT_GT(counts.misses, 1000);
}

TEST(Ccd, EdgeEdgeMissesNothing) {
  const Counts counts = compare(2, 30000, edge_edge_ccd, edge_edge_distance);
  EXPECT_EQ(counts.false_negatives, 0);
  EXPECT_EQ(counts.early, 0);
  EXPECT_GT(counts.hits, 1000);
  EXPECT_GT(counts.misses, 1000);
}

TEST(Ccd, HeadOnTimeAndNormal) {
  // A vertex falls through a face of the plane z = 0, one metre in half the time.
  const Quad start{Vec3(0.2, 0.2, 1), Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0)};
  Quad end = start;
  end[0].z() = -1;
  const auto collision = vertex_face_ccd(start, end);
  ASSERT_TRUE(collision);
  EXPECT_NEAR(collision->time, 0.5, 1e-4);
  EXPECT_GT(collision->closest.difference.normalized().z(), 0.999);
}

TEST(Ccd, MinimumDistanceStopsEarlier) {
  const Quad start{Vec3(0.2, 0.2, 1), Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0)};
  Quad end = start;
  end[0].z() = 0;
  const auto collision = vertex_face_ccd(start, end, {.minimum_distance = 0.25});
  ASSERT_TRUE(collision);
  EXPECT_NEAR(collision->time, 0.75, 1e-3);
  EXPECT_LE(collision->time, 0.75);
}

TEST(Ccd, CoplanarSlidingCounts) {
  // A vertex slides within the plane of a face into it: the cubic of coplanarity vanishes all the way.
  const Quad start{Vec3(-1, 0.3, 0), Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0)};
  Quad end = start;
  end[0].x() = 0.2;
  EXPECT_TRUE(vertex_face_ccd(start, end));
  // Two parallel edges that pass through each other.
  const Quad edges{Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0.5, 1, 0), Vec3(1.5, 1, 0)};
  Quad edges_end = edges;
  edges_end[2].y() = edges_end[3].y() = -1;
  EXPECT_TRUE(edge_edge_ccd(edges, edges_end));
}

TEST(Ccd, RestAndCommonMotionNeverCollide) {
  const Quad close{Vec3(0.2, 0.2, 1e-6), Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0)};
  EXPECT_FALSE(vertex_face_ccd(close, close));
  Quad moved = close;
  for (Vec3& x : moved) x += Vec3(3, -2, 1);
  EXPECT_FALSE(vertex_face_ccd(close, moved));
}

TEST(Ccd, TouchingPairsReportAtOnceWhenTheyMove) {
  const Quad touching{Vec3(0.2, 0.2, 0), Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0)};
  Quad end = touching;
  end[0].z() = -0.1;
  const auto collision = vertex_face_ccd(touching, end);
  ASSERT_TRUE(collision);
  EXPECT_EQ(collision->time, 0);
}

TEST(Ccd, MotionBoundCoversTheChangeOfDistance) {
  Random random(3);
  for (int i = 0; i < 5000; ++i) {
    const Quad start = random.quad(1);
    Quad end;
    for (std::size_t k = 0; k < 4; ++k) end[k] = start[k] + random.point(0.5);
    EXPECT_LE(std::abs(vertex_face_distance(end) - vertex_face_distance(start)), motion_bound(start, end, 1) + 1e-12);
    EXPECT_LE(std::abs(edge_edge_distance(end) - edge_edge_distance(start)), motion_bound(start, end, 2) + 1e-12);
  }
}

}  // namespace
}  // namespace pleat
