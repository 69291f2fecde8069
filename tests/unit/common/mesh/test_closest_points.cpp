#include "common/mesh/closest_points.hpp"

#include <gtest/gtest.h>

#include <random>

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;

class Random {
 public:
  double in(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vec3 point() { return {in(-1, 1), in(-1, 1), in(-1, 1)}; }

 private:
  std::mt19937 engine_{7};
};

// The smallest distance over a grid of parameters: an upper bound that converges to the distance.
double sampled_vertex_face(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  double best = 1e30;
  constexpr int kSteps = 60;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; i + j <= kSteps; ++j) {
      const double u = double(i) / kSteps, v = double(j) / kSteps;
      best = std::min(best, (p - a - u * (b - a) - v * (c - a)).norm());
    }
  }
  return best;
}

double sampled_edge_edge(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  double best = 1e30;
  constexpr int kSteps = 60;
  for (int i = 0; i <= kSteps; ++i) {
    const Vec3 p = a + double(i) / kSteps * (b - a);
    best = std::min(best, (p - c - closest_on_segment(p, c, d) * (d - c)).norm());
  }
  return best;
}

void expect_consistent(const ClosestPoints& points, const std::array<Vec3, 4>& x) {
  Vec3 difference = Vec3::Zero();
  double sum = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    difference += points.weights[i] * x[i];
    sum += points.weights[i];
  }
  EXPECT_NEAR(sum, 0, 1e-12);
  EXPECT_LT((difference - points.difference).norm(), 1e-12);
  EXPECT_NEAR(points.squared_distance, points.difference.squaredNorm(), 1e-15);
}

TEST(ClosestPoints, VertexFaceAgreesWithSampling) {
  Random random;
  for (int i = 0; i < 2000; ++i) {
    const std::array<Vec3, 4> x{random.point(), random.point(), random.point(), random.point()};
    const ClosestPoints points = closest_vertex_face(x[0], x[1], x[2], x[3]);
    expect_consistent(points, x);
    for (int k = 1; k < 4; ++k) EXPECT_LE(points.weights[static_cast<std::size_t>(k)], 0);
    const double sampled = sampled_vertex_face(x[0], x[1], x[2], x[3]);
    EXPECT_LE(std::sqrt(points.squared_distance), sampled + 1e-12);
    EXPECT_GE(std::sqrt(points.squared_distance), sampled - 0.05);
  }
}

TEST(ClosestPoints, EdgeEdgeAgreesWithSampling) {
  Random random;
  for (int i = 0; i < 4000; ++i) {
    std::array<Vec3, 4> x{random.point(), random.point(), random.point(), random.point()};
    if (i % 4 == 0) x[3] = x[2] + random.in(-1, 1) * (x[1] - x[0]);                        // parallel
    if (i % 8 == 1) x[3] = x[2] + (x[1] - x[0]) + 1e-7 * random.point();                   // nearly
    if (i % 16 == 2) x[3] = x[2];                                                          // no length
    if (i % 16 == 10) x[2] = x[0] + 0.3 * (x[1] - x[0]), x[3] = x[0] + 2 * (x[1] - x[0]);  // collinear, overlapping
    const ClosestPoints points = closest_edge_edge(x[0], x[1], x[2], x[3]);
    expect_consistent(points, x);
    const double sampled = sampled_edge_edge(x[0], x[1], x[2], x[3]);
    EXPECT_LE(std::sqrt(points.squared_distance), sampled + 1e-7) << i;
    EXPECT_GE(std::sqrt(points.squared_distance), sampled - 0.05) << i;
  }
}

TEST(ClosestPoints, DegenerateTriangleIsItsEdges) {
  // All corners on a line, and all in one point.
  const Vec3 a(0, 0, 0), b(1, 0, 0), c(0.25, 0, 0);
  EXPECT_NEAR(closest_vertex_face(Vec3(0.5, 2, 0), a, b, c).squared_distance, 4, 1e-12);
  EXPECT_NEAR(closest_vertex_face(Vec3(3, 0, 0), a, b, c).squared_distance, 4, 1e-12);
  EXPECT_NEAR(closest_vertex_face(Vec3(0, 3, 0), a, a, a).squared_distance, 9, 1e-12);
}

TEST(ClosestPoints, InteriorTellsFacesFromBorders) {
  const Vec3 a(0, 0, 0), b(1, 0, 0), c(0, 1, 0);
  EXPECT_TRUE(closest_vertex_face(Vec3(0.2, 0.2, 1), a, b, c).interior);
  EXPECT_FALSE(closest_vertex_face(Vec3(2, 2, 1), a, b, c).interior);
  EXPECT_TRUE(closest_edge_edge(Vec3(0, -1, 1), Vec3(0, 1, 1), Vec3(-1, 0, 0), Vec3(1, 0, 0)).interior);
  EXPECT_FALSE(closest_edge_edge(Vec3(5, -1, 1), Vec3(5, 1, 1), Vec3(-1, 0, 0), Vec3(1, 0, 0)).interior);
}

}  // namespace
}  // namespace pleat
