#include "services/dataset/planar_mesh.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <utility>

namespace pleat::dataset {
namespace {

using Eigen::Vector2d;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

Points square(double side, double edge) {
  const Vector2d a(0, 0), b(side, 0), c(side, side), d(0, side);
  return cut_sides({{a, b}, {b, c}, {c, d}, {d, a}}, edge);
}

Points circle(double radius, double edge) {
  Points side;
  for (int k = 0; k <= 360; ++k) {
    const double t = k * std::numbers::pi / 180;
    side.push_back(radius * Vector2d(std::cos(t), std::sin(t)));
  }
  return cut_sides({side}, edge);
}

TEST(PlanarMesh, SidesAreCutIntoEqualEdges) {
  const Points points = square(1, 0.11);
  ASSERT_EQ(points.size(), 4u * 9);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_NEAR((points[(i + 1) % points.size()] - points[i]).norm(), 1.0 / 9, 1e-12);
  }
  EXPECT_EQ(points[9], Vector2d(1, 0));
}

/// Whatever the pattern: triangles that turn left, fill the outline, and are Delaunay's or nearly.
TEST(PlanarMesh, TrianglesCoverTheOutline) {
  for (const Pattern pattern : {Pattern::kSquare, Pattern::kDiagonals, Pattern::kHexagonal, Pattern::kIrregular}) {
    for (const Points& outline : {square(1, 0.1), circle(0.6, 0.1)}) {
      SCOPED_TRACE(static_cast<int>(pattern));
      Random random(3);
      const PlanarMesh mesh = mesh_outline(outline, 0.1, pattern, random);
      double wanted = 0, sum = 0;
      for (std::size_t i = 0; i < outline.size(); ++i) {
        EXPECT_EQ(mesh.points[i], outline[i]);
        wanted += 0.5 * cross(outline[i], outline[(i + 1) % outline.size()]);
      }
      std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
      for (const auto& face : mesh.faces) {
        const Vector2d &a = mesh.points[face[0]], &b = mesh.points[face[1]], &c = mesh.points[face[2]];
        EXPECT_GT(cross(b - a, c - a), 0);
        sum += 0.5 * cross(b - a, c - a);
        for (std::size_t k = 0; k < 3; ++k) ++edges[std::minmax(face[k], face[(k + 1) % 3])];
      }
      EXPECT_NEAR(sum, wanted, 1e-9);
      // Euler's formula of a disc.
      EXPECT_EQ(mesh.points.size() + mesh.faces.size(), edges.size() + 1);
      double length = 0;
      for (const auto& [edge, count] : edges) length += (mesh.points[edge.first] - mesh.points[edge.second]).norm();
      EXPECT_NEAR(length / static_cast<double>(edges.size()), 0.11, 0.025);
    }
  }
}

TEST(PlanarMesh, DiagonalsOfASquareGridAreAlike) {
  Random random(1);
  const PlanarMesh mesh = mesh_outline(square(1, 0.125), 0.125, Pattern::kSquare, random);
  ASSERT_EQ(mesh.points.size(), 81u);
  ASSERT_EQ(mesh.faces.size(), 128u);
  std::size_t rising = 0, falling = 0;
  for (const auto& face : mesh.faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Vector2d side = mesh.points[face[(k + 1) % 3]] - mesh.points[face[k]];
      if (std::abs(side.x()) < 1e-9 || std::abs(side.y()) < 1e-9) continue;
      ++(side.x() * side.y() > 0 ? rising : falling);
    }
  }
  EXPECT_EQ(rising + falling, 128u);
  EXPECT_TRUE(rising == 0 || falling == 0);
}

}  // namespace
}  // namespace pleat::dataset
