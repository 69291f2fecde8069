#include "services/refinement/obstacle_field.hpp"

#include <gtest/gtest.h>

#include <random>

#include "common/base/error.hpp"
#include "services/refinement/judge.hpp"
#include "tests/unit/services/refinement/independent_judge.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat {
namespace {

ObstacleFrame mesh_frame(const std::string& name, const Positions& positions) {
  ObstacleFrame frame;
  frame.name = name;
  frame.positions = positions;
  return frame;
}

class Closed : public testing::TestWithParam<test::ClosedMesh> {};
INSTANTIATE_TEST_SUITE_P(All, Closed, testing::Values(test::torus(0.5f, 0.2f), test::cube(0.4f)));

TEST_P(Closed, SignsAgreeWithWindingNumbersAndDistancesWithAScan) {
  const auto& mesh = GetParam();
  MeshObstacle obstacle(mesh.faces, mesh.positions.rows(), "mesh");
  obstacle.update(mesh.positions);
  std::mt19937 random(2);
  std::uniform_real_distribution<double> uniform(-0.8, 0.8);
  int inside = 0;
  for (int i = 0; i < 800; ++i) {
    const Eigen::Vector3d p(uniform(random), 0.5 * uniform(random), uniform(random));
    double nearest = 1e9;
    constexpr int kSteps = 12;
    for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
      for (int a = 0; a <= kSteps; ++a) {
        for (int b = 0; a + b <= kSteps; ++b) {
          const Eigen::Vector3d q = (a * mesh.positions.row(mesh.faces(f, 0)).cast<double>() +
                                     b * mesh.positions.row(mesh.faces(f, 1)).cast<double>() +
                                     (kSteps - a - b) * mesh.positions.row(mesh.faces(f, 2)).cast<double>()) /
                                    kSteps;
          nearest = std::min(nearest, (p - q).norm());
        }
      }
      if (i > 100) break;  // the scan is slow: distances for the first points only
    }
    const auto contact = obstacle.contact(p, 10);
    ASSERT_TRUE(contact.has_value());
    const bool expected = test::winding_number(mesh.positions, mesh.faces, p) > 0.5;
    EXPECT_EQ(contact->distance < 0, expected) << p.transpose();
    inside += expected;
    if (i <= 100) {
      EXPECT_LE(std::abs(contact->distance), nearest + 1e-9);
      EXPECT_GE(std::abs(contact->distance), nearest - 0.05);
    }
    EXPECT_NEAR(contact->normal.norm(), 1, 1e-9);
    // Along the normal the surface is reached.
    const auto surface = obstacle.contact(p - contact->distance * contact->normal, 10);
    EXPECT_NEAR(surface->distance, 0, 1e-6);
    const auto out_of_reach = obstacle.contact(p, 0.9 * std::abs(contact->distance));
    EXPECT_EQ(out_of_reach.has_value(), expected);
  }
  EXPECT_GT(inside, 50);
}

TEST(ObstacleField, AFaceAcrossASphereCountsThoughItsCornersAreOutside) {
  Positions x(3, 3);
  x << -1, 0.05f, -1, 1, 0.05f, -1, 0, 0.05f, 1;
  Faces faces(1, 3);
  faces << 0, 1, 2;
  const std::vector<ObstacleFrame> frames{test::sphere("ball", {0, 0, -0.2f}, 0.1f)};
  EXPECT_EQ(count_penetrations(x, faces, {}, frames), 1u);
  x.col(1).setConstant(0.1f);  // touching is no penetration
  EXPECT_EQ(count_penetrations(x, faces, {}, frames), 0u);
}

TEST(ObstacleField, FacesInsideAcrossAndAroundAMesh) {
  const test::ClosedMesh cube = test::cube(0.4f);
  const std::vector<ObstacleShape> shapes{{"cube", cube.faces}};
  const std::vector<ObstacleFrame> frames{mesh_frame("cube", cube.positions)};
  Positions x(3, 3);
  Faces faces(1, 3);
  faces << 0, 1, 2;
  x << 0, 0, 0, 0.1f, 0, 0, 0, 0, 0.1f;
  EXPECT_EQ(count_penetrations(x, faces, shapes, frames), 1u);  // inside
  x << 0, 0, 0, 1, 0, 0, 0, 0, 1;
  EXPECT_EQ(count_penetrations(x, faces, shapes, frames), 1u);  // one corner inside
  x << -3, 0.1f, -3, 3, 0.1f, -3, 0, 0.1f, 5;
  EXPECT_EQ(count_penetrations(x, faces, shapes, frames), 1u);  // corners outside, the cube sticks through
  x.col(1).setConstant(0.41f);
  EXPECT_EQ(count_penetrations(x, faces, shapes, frames), 0u);
}

TEST(ObstacleField, BadObstaclesAreRefused) {
  const test::ClosedMesh cube = test::cube(0.4f);
  const auto update = [](std::vector<ObstacleShape> shapes, std::vector<ObstacleFrame> frames) {
    ObstacleField field(shapes);
    field.update(frames);
  };
  EXPECT_NO_THROW(update({{"c", cube.faces}}, {mesh_frame("c", cube.positions)}));
  EXPECT_THROW(update({{"", cube.faces}}, {}), Error);
  EXPECT_THROW(update({{"c", cube.faces}, {"c", cube.faces}}, {}), Error);
  EXPECT_THROW(update({{"c", cube.faces}}, {}), Error);
  EXPECT_THROW(update({}, {mesh_frame("c", cube.positions)}), Error);
  EXPECT_THROW(update({{"c", cube.faces.topRows(11)}}, {mesh_frame("c", cube.positions)}), Error);
  EXPECT_THROW(update({{"c", cube.faces}}, {mesh_frame("c", cube.positions.topRows(7))}), Error);
  EXPECT_THROW(update({}, {test::sphere("s", {0, 0, 0}, -1)}), Error);
  EXPECT_THROW(update({}, {test::sphere("s", {NAN, 0, 0}, 1)}), Error);
  EXPECT_THROW(update({}, {test::sphere("s", {0, 0, 0}, 1), test::sphere("s", {0, 0, 0}, 1)}), Error);
}

}  // namespace
}  // namespace pleat
