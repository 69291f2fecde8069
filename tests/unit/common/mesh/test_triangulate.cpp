// Triangles of a polygon cover it once and nothing else.
#include "common/mesh/triangulate.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>

namespace pleat {
namespace {

using Polygon = std::vector<Eigen::Vector3f>;

double cross(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c) {
  return static_cast<double>((b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x()));
}

double area(const Polygon& p) {
  double sum = 0;
  for (std::size_t i = 1; i + 1 < p.size(); ++i) sum += cross(p[0], p[i], p[i + 1]) / 2;
  return sum;
}

/// In the plane z = 0 all triangles turn as the polygon does, and their areas add up to its own: nothing is covered
/// twice and nothing outside.
void expect_covered(const Polygon& polygon) {
  const auto triangles = triangulate(polygon);
  ASSERT_TRUE(triangles);
  ASSERT_EQ(triangles->size(), polygon.size() - 2);
  const double whole = area(polygon);
  double sum = 0;
  for (const auto& [a, b, c] : *triangles) {
    const double part = cross(polygon[a], polygon[b], polygon[c]) / 2;
    EXPECT_GE(part * (whole > 0 ? 1 : -1), -1e-6);
    sum += part;
  }
  EXPECT_NEAR(sum, whole, 1e-5 * std::abs(whole));
}

TEST(Triangulate, ConvexPolygonsAreFans) {
  const Polygon square{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  const std::vector<std::array<std::uint32_t, 3>> fan{{0, 1, 2}, {0, 2, 3}};
  EXPECT_EQ(triangulate(square), fan);
  // Without area there is nothing to cover; the corners stay connected.
  EXPECT_EQ(triangulate(Polygon(4, Eigen::Vector3f(1, 2, 3))), fan);
}

TEST(Triangulate, ConcavePolygonsFromAnyFirstCornerAndEitherWay) {
  const Polygon shapes[] = {
      {{0, 0, 0}, {2, 0, 0}, {0.5, 0.5, 0}, {0, 2, 0}},
      {{0, 0, 0}, {2, 0, 0}, {2, 1, 0}, {1, 1, 0}, {1, 2, 0}, {0, 2, 0}},
      {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}, {3, 3, 0}, {2, 1, 0}, {1, 1, 0}, {0, 3, 0}},
      // a square with a square hole, joined by a bridge
      {{0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {0, 4, 0}, {0, 0, 0}, {1, 1, 0}, {1, 3, 0}, {3, 3, 0}, {3, 1, 0}, {1, 1, 0}}};
  for (Polygon shape : shapes) {
    for (std::size_t k = 0; k < shape.size(); ++k) {
      std::rotate(shape.begin(), shape.begin() + 1, shape.end());
      expect_covered(shape);
    }
    std::reverse(shape.begin(), shape.end());
    expect_covered(shape);
  }
}

TEST(Triangulate, RandomStars) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> radius(0.2f, 1.0f);
  for (int round = 0; round < 300; ++round) {
    Polygon star;
    const int corners = 4 + round % 12;
    for (int i = 0; i < corners; ++i) {
      const float r = radius(random),
                  angle = 2 * static_cast<float>(M_PI) * static_cast<float>(i) / static_cast<float>(corners);
      star.emplace_back(r * std::cos(angle), r * std::sin(angle), 0);
    }
    expect_covered(star);
  }
}

TEST(Triangulate, InAnyPlane) {
  Polygon shape{{0, 0, 0}, {2, 0, 0}, {2, 1, 0}, {1, 1, 0}, {1, 2, 0}, {0, 2, 0}};
  std::rotate(shape.begin(), shape.begin() + 4, shape.end());
  const auto flat = triangulate(shape);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(1.1f, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  for (Eigen::Vector3f& corner : shape) corner = turn * corner * 100 + Eigen::Vector3f(5, 6, 7);
  const auto triangles = triangulate(shape);
  ASSERT_TRUE(triangles && flat);
  EXPECT_EQ(triangles->size(), flat->size());
  double sum = 0;
  for (const auto& [a, b, c] : *triangles)
    sum += static_cast<double>((shape[b] - shape[a]).cross(shape[c] - shape[a]).norm()) / 2;
  EXPECT_NEAR(sum, 3e4, 10);
}

TEST(Triangulate, RefusesWhatCrossesItself) {
  EXPECT_FALSE(triangulate(Polygon{{0, 0, 0}, {2, 2, 0}, {2, 0, 0}, {0, 1, 0}, {-3, 0.5, 0}}));
}

}  // namespace
}  // namespace pleat
