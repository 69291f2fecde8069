// Intersecting pairs of random soups, against all pairs judged one by one (by CGAL where it is installed).
#include <gtest/gtest.h>

#include <random>

#include "services/refinement/judge.hpp"
#include "services/refinement/self_intersection_finder.hpp"
#include "tests/unit/services/refinement/independent_judge.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

// Coordinates whose coincidences grow: free floats; a grid on which points touch edges and faces; a coarse grid with
// half of the points in one plane; a plane up to a few roundings; a line up to a few roundings.
class Soups : public testing::TestWithParam<int> {
 protected:
  Eigen::RowVector3f point() {
    const float x = uniform(random), y = uniform(random);
    const auto roundings = [this] { return 6e-8f * static_cast<float>(static_cast<int>(random() % 5) - 2); };
    switch (GetParam()) {
      case 0:
        return {x, y, uniform(random)};
      case 1:
        return {grid(5), grid(5), grid(5)};
      case 2:
        return {grid(4), grid(4), random() % 2 == 0 ? 0.f : grid(4)};
      case 3:
        return {x, y, 0.3f * x - 0.7f * y + 1 + roundings()};
      default:
        return {x + roundings(), 0.5f * x + roundings(), 0.25f * x + roundings()};
    }
  }
  float grid(unsigned steps) { return 0.1f * static_cast<float>(random() % steps); }

  std::mt19937 random{17u + static_cast<unsigned>(GetParam())};
  std::uniform_real_distribution<float> uniform{0, 1};
};
INSTANTIATE_TEST_SUITE_P(Kinds, Soups, testing::Range(0, 5));

TEST_P(Soups, OfFacesThatShareVerticesAtRandom) {
  std::size_t found = 0, faceless = 0;
  for (int soup = 0; soup < 1500; ++soup) {
    const auto vertices = static_cast<std::uint32_t>(5 + random() % 14);
    Positions x(vertices, 3);
    for (Eigen::Index v = 0; v < x.rows(); ++v) x.row(v) = point();
    Faces faces(static_cast<Eigen::Index>(2 + random() % 10), 3);
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      const std::uint32_t a = static_cast<std::uint32_t>(random() % vertices);
      const std::uint32_t b = (a + 1 + static_cast<std::uint32_t>(random() % (vertices - 1))) % vertices;
      std::uint32_t c = a;
      while (c == a || c == b) c = static_cast<std::uint32_t>(random() % vertices);
      faces.row(f) << a, b, c;
    }
    const auto expected = test::all_self_intersections(x, faces);
    ASSERT_EQ(find_self_intersections(x, faces), expected) << "soup " << soup;
    found += expected.size();
    faceless += expected.empty();
  }
  EXPECT_GT(found, 2000u);
  if (GetParam() == 0) {
    EXPECT_GT(faceless, 100u);
  }
}

// Sheets of patches, so that whole neighbourhoods are excluded: smooth, creased, folded flat, crumpled.
TEST_P(Soups, OfSheets) {
  const Topology coarse = test::square_sheet(3, 1);
  const Subdivision fine = subdivide(coarse, 1);
  const Faces& faces = fine.fine.faces;
  SelfIntersectionFinder finder(faces, fine.fine.vertex_count(), coarse.faces);
  std::size_t found = 0, clean = 0;
  for (int soup = 0; soup < 250; ++soup) {
    Positions x = upsample(fine, coarse.faces, coarse.rest_positions);
    switch (soup % 5) {
      case 0:  // folded flat along a line of vertices
        for (Eigen::Index v = 0; v < x.rows(); ++v) x(v, 0) = std::abs(x(v, 0) - 0.5f);
        break;
      case 1:  // a few vertices anywhere
        for (int i = 0; i < 3; ++i) x.row(static_cast<Eigen::Index>(random() % 49)) = point();
        break;
      case 2:  // everything anywhere
        for (Eigen::Index v = 0; v < x.rows(); ++v) x.row(v) = point();
        break;
      case 3:  // rolled up
        for (Eigen::Index v = 0; v < x.rows(); ++v) {
          const float angle = 9 * x(v, 0), r = 0.2f + 0.01f * static_cast<float>(soup % 7) * x(v, 0);
          x.row(v) << r * std::cos(angle), r * std::sin(angle), x(v, 2);
        }
        break;
      default:  // gentle
        x += test::noise(x.rows(), 0.004f * static_cast<float>(soup % 11), static_cast<unsigned>(soup));
    }
    const auto expected = test::all_self_intersections(x, faces);
    finder.update(x);
    std::vector<FacePair> pairs;
    ASSERT_TRUE(finder.find(x, kMaxReportedPairs, pairs));
    ASSERT_EQ(pairs, expected) << "soup " << soup;
    found += expected.size();
    clean += expected.empty();
  }
  EXPECT_GT(found, 1000u);
  EXPECT_GT(clean, 10u);
}

}  // namespace
}  // namespace pleat::refinement
