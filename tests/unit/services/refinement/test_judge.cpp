#include "services/refinement/judge.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "common/base/error.hpp"
#include "services/refinement/self_intersection_finder.hpp"
#include "tests/unit/services/refinement/independent_judge.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

using test::load_cloth;

class NoisyCloth : public testing::TestWithParam<std::tuple<const char*, float>> {};
INSTANTIATE_TEST_SUITE_P(All, NoisyCloth,
                         testing::Combine(testing::Values("tablecloth", "skirt"),
                                          testing::Values(0.f, 0.001f, 0.004f)));

TEST_P(NoisyCloth, FindsExactlyThePairsOfTheSweep) {
  const auto [name, sigma] = GetParam();
  const test::Cloth cloth = load_cloth(name);
  const Faces& faces = cloth.fine().faces;
  const Positions x = upsample(cloth.subdivision, cloth.coarse.faces, test::wavy(cloth.coarse.rest_positions)) +
                      test::noise(cloth.fine().vertex_count(), sigma, 3);
  const auto expected = test::sweep_self_intersections(x, faces);
  EXPECT_EQ(find_self_intersections(x, faces), expected);
  SelfIntersectionFinder by_patch(faces, x.rows(), cloth.coarse.faces);
  by_patch.update(x);
  std::vector<FacePair> pairs;
  EXPECT_TRUE(by_patch.find(x, kMaxReportedPairs, pairs));
  EXPECT_EQ(pairs, expected);
  if (sigma == 0.f) {
    EXPECT_TRUE(expected.empty());
  }
  if (sigma == 0.004f) {
    EXPECT_GT(expected.size(), 50u);
    EXPECT_FALSE(by_patch.find(x, 10, pairs));
    EXPECT_EQ(pairs.size(), 10u);
  }
}

TEST(Finder, FollowsAMovingMesh) {
  const test::Cloth cloth = load_cloth("tablecloth");
  const Faces& faces = cloth.fine().faces;
  SelfIntersectionFinder finder(faces, cloth.fine().vertex_count(), cloth.coarse.faces);
  for (unsigned frame = 0; frame < 4; ++frame) {
    Positions x = test::wavy(cloth.fine().rest_positions) + test::noise(cloth.fine().vertex_count(), 0.003f, frame);
    x.rowwise() += Eigen::RowVector3f(static_cast<float>(frame), 0, 0);
    finder.update(x);
    std::vector<FacePair> pairs;
    finder.find(x, kMaxReportedPairs, pairs);
    EXPECT_EQ(pairs, test::sweep_self_intersections(x, faces)) << frame;
  }
}

TEST(Finder, SearchesMovedPatchesAgain) {
  const test::Cloth cloth = load_cloth("tablecloth");
  const Faces& faces = cloth.fine().faces;
  ThreadPool pool(2);
  SelfIntersectionFinder again(faces, cloth.fine().vertex_count(), cloth.coarse.faces, &pool);
  Positions x = test::wavy(cloth.fine().rest_positions) + test::noise(cloth.fine().vertex_count(), 0.003f, 1);
  again.update(x);
  std::vector<FacePair> pairs;
  ASSERT_TRUE(again.find(x, kMaxReportedPairs, pairs));
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(-0.03f, 0.03f);
  std::size_t changed = 0;
  for (const int vertices : {0, 1, 3, 20, 2, 700, 1, 10}) {  // 700 touch most patches
    std::vector<std::uint32_t> moved;
    for (int i = 0; i < vertices; ++i) {
      const auto v = static_cast<std::uint32_t>(random() % static_cast<std::size_t>(x.rows()));
      x.row(v) += Eigen::RowVector3f(uniform(random), uniform(random), uniform(random));
      const auto patches = again.patches_at(v);
      moved.insert(moved.end(), patches.begin(), patches.end());
    }
    std::sort(moved.begin(), moved.end());
    moved.erase(std::unique(moved.begin(), moved.end()), moved.end());
    const std::vector<FacePair> earlier = pairs;
    ASSERT_TRUE(again.find_again(x, moved, kMaxReportedPairs, pairs));
    EXPECT_EQ(pairs, test::sweep_self_intersections(x, faces)) << vertices;
    changed += pairs != earlier;
  }
  EXPECT_GT(changed, 4u);
  EXPECT_FALSE(again.find_again(x, {}, pairs.size() - 1, pairs));
}

TEST(Finder, ACrumpledSheetWithManyFolds) {
  // Rolled up with touching layers: smooth almost everywhere, so that exclusions apply, but intersecting.
  const test::Cloth cloth = load_cloth("tablecloth");
  Positions x = cloth.fine().rest_positions;
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    const float angle = 14 * x(v, 0), radius = 0.1f + 0.02f * std::sin(3 * angle);
    x.row(v) << radius * std::cos(angle), radius * std::sin(angle), x(v, 2);
  }
  const auto expected = test::sweep_self_intersections(x, cloth.fine().faces);
  EXPECT_GT(expected.size(), 500u);
  EXPECT_EQ(find_self_intersections(x, cloth.fine().faces), expected);
}

TEST(Finder, AClosedMeshAndABowTie) {
  const test::ClosedMesh torus = test::torus(0.5f, 0.2f);
  EXPECT_EQ(count_self_intersections(torus.positions, torus.faces), 0u);
  // Two faces that meet in one vertex only, twice around it.
  Positions x(5, 3);
  x << 0, 0, 0, 1, 0, 0, 0, 1, 0, -1, 0, 0.1f, 0, -1, 0;
  Faces faces(2, 3);
  faces << 0, 1, 2, 0, 3, 4;
  EXPECT_EQ(count_self_intersections(x, faces), 0u);
  x.row(3) << 0.5f, 0.5f, -1;
  x.row(4) << 0.5f, 0.5f, 1;
  EXPECT_EQ(count_self_intersections(x, faces), 1u);
}

TEST(Finder, AnUmbrellaThatTurnsTwice) {
  // Six faces around a vertex that cover it twice: all normals agree, and still they intersect.
  Positions x = Positions::Zero(7, 3);
  Faces faces(6, 3);
  for (int i = 0; i < 6; ++i) {
    const float angle = 4 * std::numbers::pi_v<float> * static_cast<float>(i) / 6;
    x.row(i + 1) << std::cos(angle), 0.05f * static_cast<float>(i % 2), -std::sin(angle);
    faces.row(i) << 0, static_cast<std::uint32_t>(i + 1), static_cast<std::uint32_t>((i + 1) % 6 + 1);
  }
  EXPECT_EQ(find_self_intersections(x, faces), test::sweep_self_intersections(x, faces));
  EXPECT_GT(count_self_intersections(x, faces), 0u);
}

TEST(Judge, BadInputIsRefused) {
  const Topology sheet = test::square_sheet(2, 1);
  EXPECT_THROW(count_self_intersections(sheet.rest_positions.topRows(3), sheet.faces), Error);
  Positions broken = sheet.rest_positions;
  broken(1, 1) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(count_self_intersections(broken, sheet.faces), Error);
  EXPECT_THROW(count_penetrations(broken, sheet.faces, {}, {}), Error);
  EXPECT_EQ(count_self_intersections(Positions(0, 3), Faces(0, 3)), 0u);
  EXPECT_THROW(SelfIntersectionFinder(sheet.faces, 9, sheet.faces.topRows(3)), Error);
}

}  // namespace
}  // namespace pleat::refinement
