#include "common/mesh/closest_points8.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "common/mesh/closest_points.hpp"

namespace pleat {
namespace {

using Vec3 = Eigen::Vector3d;

struct Case {
  Points8 points[4];
  Vec3 lanes[8][4];
};

// Points in a cube about somewhere; flat: triangles x1, x2, x3 as thin as needles, and edges that are almost parallel.
Case random_case(std::mt19937& engine, double size, const Vec3& origin, bool flat) {
  std::uniform_real_distribution<double> uniform(-size, size);
  Case result{};
  for (int lane = 0; lane < 8; ++lane) {
    auto& x = result.lanes[lane];
    for (Vec3& p : x) p = origin + Vec3(uniform(engine), uniform(engine), uniform(engine));
    if (flat) x[3] = x[1] + 0.4 * (x[2] - x[1]) + 1e-4 * (x[3] - x[1]);
    for (int k = 0; k < 4; ++k) {
      x[k] = x[k].cast<float>().cast<double>();
      result.points[k].x[lane] = static_cast<float>(x[k].x());
      result.points[k].y[lane] = static_cast<float>(x[k].y());
      result.points[k].z[lane] = static_cast<float>(x[k].z());
    }
  }
  return result;
}

// What is measured in float32 bounds the distance from below, and not by much more than rounding.
TEST(ClosestPoints8, BoundTheDistancesOfTheDoubleOnes) {
  std::mt19937 engine(1);
  for (int i = 0; i < 4000; ++i) {
    const double size = i % 2 == 0 ? 0.01 : 1;
    const Vec3 origin = i % 3 == 0 ? Vec3(3, -2, 5) : Vec3(0, 0, 0);
    const Case c = random_case(engine, size, origin, i % 5 == 0);
    const auto& [p0, p1, p2, p3] = c.points;
    const Float8 error = max(max(rounding(p0), rounding(p1)), max(rounding(p2), rounding(p3)));
    const Float8 face = at_least(squared_vertex_face_distance(p0, p1, p2, p3), error);
    const Float8 edges = at_least(squared_edge_edge_distance(p0, p1, p2, p3), error);
    for (int lane = 0; lane < 8; ++lane) {
      const auto& x = c.lanes[lane];
      const double face_distance = std::sqrt(closest_vertex_face(x[0], x[1], x[2], x[3]).squared_distance);
      EXPECT_LE(static_cast<double>(face[lane]), face_distance);
      EXPECT_GE(static_cast<double>(face[lane]), 0.999 * face_distance - 1e-4);
      const double edge_distance = std::sqrt(closest_edge_edge(x[0], x[1], x[2], x[3]).squared_distance);
      EXPECT_LE(static_cast<double>(edges[lane]), edge_distance);
      EXPECT_GE(static_cast<double>(edges[lane]), 0.999 * edge_distance - 1e-4);
    }
  }
}

}  // namespace
}  // namespace pleat
