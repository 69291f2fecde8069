#include "common/frame/obstacle_field.hpp"

#include <gtest/gtest.h>

#include <random>

#include "common/base/error.hpp"
#include "common/mesh/triangle_intersection.hpp"
#include "services/refinement/judge.hpp"
#include "tests/unit/services/refinement/independent_judge.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
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

// With a depth, what is deeper inside a mesh is not found, and everything else is as without, wherever the search
// before ended.
TEST(ObstacleField, NearContactsAreContactsUpToADepth) {
  const test::ClosedMesh torus = test::torus(0.5f, 0.2f);
  const std::vector<ObstacleShape> shapes{{"torus", torus.faces}};
  ObstacleField field(shapes);
  field.update(std::vector{mesh_frame("torus", torus.positions)});
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-0.8, 0.8);
  int deep = 0, found = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d p(uniform(random), 0.3 * uniform(random), uniform(random));
    const auto all = field.contact(p, 0.05), near = field.contact_near(p, 0.05, 0.1);
    if (all && all->distance < -0.1) {
      EXPECT_FALSE(near);
      ++deep;
      continue;
    }
    ASSERT_EQ(near.has_value(), all.has_value());
    if (!near) continue;
    EXPECT_EQ(near->distance, all->distance);
    EXPECT_EQ(near->normal, all->normal);
    ++found;
  }
  EXPECT_GT(deep, 20);
  EXPECT_GT(found, 100);
}

// Packs found for a box answer as the whole mesh does: contacts of the points in it, intersections of the triangles in
// it.
TEST_P(Closed, PacksNearABoxAnswerAsTheMesh) {
  const auto& mesh = GetParam();
  MeshObstacle obstacle(mesh.faces, mesh.positions.rows(), "mesh");
  obstacle.update(mesh.positions);
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto any = [&] { return Eigen::Vector3d(uniform(random), uniform(random), uniform(random)); };
  constexpr double kReach = 0.04;
  int near = 0, crossing = 0;
  std::vector<std::uint32_t> packs;
  for (int i = 0; i < 500; ++i) {
    const Eigen::Vector3d center = 0.7 * any();
    std::array<Eigen::Vector3f, 3> triangle;
    Box box;
    for (Eigen::Vector3f& corner : triangle) {
      corner = (center + 0.1 * any()).cast<float>();
      box.extend(corner.cast<double>());
    }
    packs.clear();
    obstacle.find_packs(widened(box, kReach), packs);
    for (const Eigen::Vector3f& corner : triangle) {
      std::uint32_t hint = kNone;
      const auto expected = obstacle.contact_near(corner.cast<double>(), kReach, hint);
      const auto found = obstacle.contact_near(corner.cast<double>(), kReach, packs);
      ASSERT_EQ(found.has_value(), expected.has_value());
      if (!found) continue;
      EXPECT_EQ(found->distance, expected->distance);
      EXPECT_EQ(found->normal, expected->normal);
      ++near;
    }
    bool expected = false;
    for (std::uint32_t f = 0; f < static_cast<std::uint32_t>(mesh.faces.rows()); ++f) {
      expected = expected || triangles_intersect(
                                 triangle, {mesh.positions.row(mesh.faces(f, 0)), mesh.positions.row(mesh.faces(f, 1)),
                                            mesh.positions.row(mesh.faces(f, 2))});
    }
    EXPECT_EQ(obstacle.intersects(triangle, packs), expected);
    EXPECT_EQ(obstacle.intersects(triangle), expected);
    crossing += expected;
  }
  EXPECT_GT(near, 20);
  EXPECT_GT(crossing, 20);
}

TEST(Capsules, FacesAgreeWithAScan) {
  std::mt19937 random(6);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto any = [&] { return Eigen::Vector3d(uniform(random), uniform(random), uniform(random)); };
  int pierced = 0;
  for (int i = 0; i < 400; ++i) {
    Capsule capsule{any(), any(), 0.1 + 0.05 * uniform(random)};
    if (i % 4 == 0) capsule.b = capsule.a;  // a sphere
    const Eigen::Vector3d a = any(), b = any(), c = any();
    constexpr int kSteps = 24;
    double nearest = 1e9;
    for (int j = 0; j <= kSteps; ++j) {
      for (int k = 0; j + k <= kSteps; ++k) {
        const Eigen::Vector3d p = (j * a + k * b + (kSteps - j - k) * c) / kSteps;
        for (int s = 0; s <= kSteps; ++s) {
          nearest = std::min(nearest, (p - capsule.a - (capsule.b - capsule.a) * s / kSteps).norm());
        }
        // A point by itself.
        if (j + k > 2) continue;
        const ObstacleContact contact = capsule_contact(capsule, p);
        EXPECT_NEAR(capsule_contact(capsule, p - contact.distance * contact.normal).distance, 0, 1e-12);
      }
    }
    const TriangleContact found = capsule_contact(capsule, a, b, c);
    EXPECT_NEAR(found.weights.sum(), 1, 1e-12);
    EXPECT_GE(found.weights.minCoeff(), 0);
    const Eigen::Vector3d p = found.weights[0] * a + found.weights[1] * b + found.weights[2] * c;
    EXPECT_NEAR(capsule_contact(capsule, p).distance, found.contact.distance, 1e-9);
    EXPECT_LE(found.contact.distance + capsule.radius, nearest + 1e-12);
    EXPECT_GE(found.contact.distance + capsule.radius, nearest - 0.15);  // the scan's spacing
    EXPECT_NEAR(found.contact.normal.norm(), 1, 1e-12);
    pierced += found.contact.distance + capsule.radius < 1e-9;
  }
  EXPECT_GT(pierced, 10);
}

TEST(Capsules, ASetIsTheUnionOfItsParts) {
  ObstacleField field({});
  ObstacleFrame arm;
  arm.name = "arm";
  arm.capsule_ends.resize(4, 3);
  arm.capsule_ends << 0, 0, 0, 1, 0, 0, 1, 0, 0, 1, 1, 0;
  arm.capsule_radii = {0.125f, 0.25f};
  field.update(std::vector{arm});
  EXPECT_FALSE(field.empty());
  EXPECT_NEAR(field.contact({0.5, 0.3, 0}, 1)->distance, 0.175, 1e-12);
  EXPECT_NEAR(field.contact({1, 0.5, 0}, 0)->distance, -0.25, 1e-12);
  EXPECT_FALSE(field.contact({0.5, 0.3, 0}, 0.1));
  std::vector<Box> bounds;
  field.append_bounds(0.05, bounds);
  EXPECT_EQ(bounds.size(), 2u);
  Positions x(3, 3);
  Faces faces(1, 3);
  faces << 0, 1, 2;
  x << 0.5f, 0.15f, -1, 0.5f, 0.15f, 1, 0.2f, 0.15f, 0;  // above the thin one
  EXPECT_FALSE(field.penetrates(x, faces, 0));
  x.row(2) << 1.2f, 0.15f, 0;  // into the thick one
  EXPECT_TRUE(field.penetrates(x, faces, 0));
  EXPECT_TRUE(field.push_face_out(x, faces, 0, 0.002));
  for (int i = 0; i < 20 && field.penetrates(x, faces, 0); ++i) field.push_face_out(x, faces, 0, 0.002);
  EXPECT_FALSE(field.penetrates(x, faces, 0));
  for (const auto& spoil : {+[](ObstacleFrame& f) { f.capsule_ends.conservativeResize(3, 3); },
                            +[](ObstacleFrame& f) { f.capsule_ends(2, 0) = std::nanf(""); },
                            +[](ObstacleFrame& f) { f.capsule_radii[1] = 0; }}) {
    ObstacleFrame bad = arm;
    spoil(bad);
    EXPECT_THROW(field.update(std::vector{bad}), Error);
  }
  field.update({});
  EXPECT_TRUE(field.empty());
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

// A wall of two triangles has its corners half a metre away: they say nothing about a small face that reaches into it.
TEST(ObstacleField, FarCornersOfLargeFacesDoNotThrowTheCloth) {
  const auto cube = test::cube(0.5f);
  const ObstacleShape shape{"box", cube.faces};
  ObstacleField field(std::span(&shape, 1));
  field.update(std::vector{mesh_frame("box", cube.positions)});
  Faces faces(1, 3);
  faces << 0, 1, 2;
  const float top = cube.positions.col(1).maxCoeff();
  for (const float depth : {0.001f, 0.009f}) {
    Positions cloth(3, 3);
    cloth << 0.1f, top - depth, 0.07f, 0.12f, top + 0.01f, 0.07f, 0.11f, top + 0.01f, 0.09f;
    const Positions before = cloth;
    for (int sweep = 0; sweep < 12; ++sweep) field.push_face_out(cloth, faces, 0, 2e-3);
    EXPECT_LT((cloth - before).rowwise().norm().maxCoeff(), 0.04f) << depth;
  }
}

}  // namespace
}  // namespace pleat::refinement
