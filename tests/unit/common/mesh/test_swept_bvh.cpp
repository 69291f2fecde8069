#include "common/mesh/swept_bvh.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

#include "common/base/error.hpp"
#include "common/mesh/ccd.hpp"

namespace pleat {
namespace {

using Eigen::Vector3d;
using Faces = std::vector<std::array<std::uint32_t, 3>>;

struct Soup {
  std::vector<Vector3d> start, end;
  Faces faces;

  // Triangles of a size in a cube; half of them share vertices with the one before. They fall fast together, and move a
  // little each.
  Soup(std::size_t count, double size, double own_motion, std::uint32_t seed) {
    std::mt19937 engine(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    const auto point = [&] { return Vector3d(uniform(engine), uniform(engine), uniform(engine)); };
    for (std::uint32_t f = 0; f < count; ++f) {
      std::array<std::uint32_t, 3> face{};
      const Vector3d center = point();
      for (std::size_t k = 0; k < 3; ++k) {
        if (f % 2 == 1 && k < 1 + f % 3 % 2) {
          face[k] = faces.back()[k];
        } else {
          face[k] = static_cast<std::uint32_t>(start.size());
          start.push_back(center + size * point());
          end.push_back(start.back() + Vector3d(3, -50, 2) + own_motion * point());
        }
      }
      faces.push_back(face);
    }
  }
  std::vector<SweptBox> boxes(double margin) const {
    std::vector<SweptBox> result;
    for (std::size_t i = 0; i < start.size(); ++i) result.emplace_back(start[i], end[i], margin);
    return result;
  }
  bool share(std::uint32_t f, std::uint32_t g) const {
    for (const std::uint32_t v : faces[f]) {
      if (std::find(faces[g].begin(), faces[g].end(), v) != faces[g].end()) return true;
    }
    return false;
  }
  // Whether a corner of one comes near the other face on the way.
  bool meet(std::uint32_t f, std::uint32_t g, double distance) const {
    for (const auto& [a, b] : {std::pair{f, g}, std::pair{g, f}}) {
      for (const std::uint32_t v : faces[a]) {
        const auto& c = faces[b];
        if (vertex_face_ccd({start[v], start[c[0]], start[c[1]], start[c[2]]},
                            {end[v], end[c[0]], end[c[1]], end[c[2]]}, {distance, 1e-9, 256}))
          return true;
      }
    }
    return false;
  }
};

SweptBox box_of(const Soup& soup, const std::vector<SweptBox>& boxes, std::uint32_t f) {
  SweptBox box = boxes[soup.faces[f][0]];
  box.extend(boxes[soup.faces[f][1]]);
  box.extend(boxes[soup.faces[f][2]]);
  return box;
}

TEST(SweptBvh, FindsExactlyThePairsOfTheBruteForce) {
  ThreadPool pool(2);
  for (const std::size_t count : {1u, 2u, 7u, 8u, 9u, 64u, 700u, 2000u}) {
    const double size = count > 1000 ? 0.02 : 0.1;
    const Soup soup(count, size, 0.05, static_cast<std::uint32_t>(count));
    const auto boxes = soup.boxes(1e-3);
    SweptBvh bvh(soup.faces, soup.start);
    bvh.refit(boxes, pool);
    for (const bool neighbours : {false, true}) {
      std::set<SweptBvh::Pair> expected;
      for (std::uint32_t f = 0; f < count; ++f) {
        for (std::uint32_t g = f + 1; g < count; ++g) {
          if (box_of(soup, boxes, f).may_meet(box_of(soup, boxes, g)) && (neighbours || !soup.share(f, g)))
            expected.insert({f, g});
        }
      }
      const auto pairs = bvh.self_pairs(pool, 10'000'000, neighbours);
      EXPECT_EQ(pairs.size(), expected.size()) << "a pair twice, or not at all";
      EXPECT_EQ(std::set<SweptBvh::Pair>(pairs.begin(), pairs.end()), expected);
    }
  }
}

TEST(SweptBvh, MissesNoCollisionAndIgnoresTheCommonMotion) {
  ThreadPool pool(1);
  const Soup soup(400, 0.06, 0.1, 3);
  SweptBvh bvh(soup.faces, soup.start);
  bvh.refit(soup.boxes(0.005), pool);
  const auto pairs = bvh.self_pairs(pool, 1'000'000);
  const std::set<SweptBvh::Pair> found(pairs.begin(), pairs.end());
  std::size_t collisions = 0;
  for (std::uint32_t f = 0; f < 400; ++f) {
    for (std::uint32_t g = f + 1; g < 400; ++g) {
      if (soup.share(f, g) || !soup.meet(f, g, 0.01)) continue;
      ++collisions;
      EXPECT_TRUE(found.contains({f, g}));
    }
  }
  EXPECT_GT(collisions, 50u);
  // Everything falls 50 m in the step: swept through space, all would meet all.
  EXPECT_LT(found.size(), 400u * 399u / 10);
}

TEST(SweptBvh, PairsAndQueriesAreThoseOfTheBoxes) {
  ThreadPool pool(1);
  const Soup a(150, 0.1, 0.1, 5), b(90, 0.2, 0.1, 6);
  SweptBvh tree_a(a.faces, a.start), tree_b(b.faces, b.start);
  const auto boxes_a = a.boxes(0.01), boxes_b = b.boxes(0.01);
  tree_a.refit(boxes_a, pool);
  tree_b.refit(boxes_b, pool);
  std::set<SweptBvh::Pair> expected;
  for (std::uint32_t f = 0; f < 150; ++f) {
    for (std::uint32_t g = 0; g < 90; ++g) {
      if (box_of(a, boxes_a, f).may_meet(box_of(b, boxes_b, g))) expected.insert({f, g});
    }
  }
  const auto pairs = tree_a.pairs(tree_b);
  EXPECT_EQ(std::set<SweptBvh::Pair>(pairs.begin(), pairs.end()), expected);
  EXPECT_EQ(pairs.size(), expected.size());

  const SweptBox ball(Vector3d(0.2, 0, 0), Vector3d(0.2, -49, 0), 0.4);
  std::vector<std::uint32_t> near;
  for (std::uint32_t f = 0; f < 150; ++f) {
    if (box_of(a, boxes_a, f).may_meet(ball)) near.push_back(f);
  }
  EXPECT_FALSE(near.empty());
  EXPECT_EQ(tree_a.query(ball), near);
}

TEST(SweptBvh, EmptyOnesAndTooManyPairs) {
  ThreadPool pool(1);
  SweptBvh empty;
  empty.refit({}, pool);
  EXPECT_TRUE(empty.empty());
  EXPECT_TRUE(empty.self_pairs(pool, 10).empty());
  EXPECT_TRUE(empty.query(SweptBox(Vector3d::Zero(), Vector3d::Zero(), 1)).empty());
  const Soup soup(200, 5, 1, 9);
  SweptBvh crowded(soup.faces, soup.start);
  crowded.refit(soup.boxes(0), pool);
  EXPECT_THROW(crowded.self_pairs(pool, 100), Error);
}

// What the other hierarchy is not near to is left out of the refit, and no pair is lost by it; nor do places of an
// earlier refit remain.
TEST(SweptBvh, ARefitForAnotherHierarchyKeepsAllPairsWithIt) {
  ThreadPool pool(1);
  for (const std::size_t count : {1u, 8u, 300u, 5000u}) {
    const Soup body(count, 0.02, 0.01, 3);
    SweptBvh whole(body.faces, body.start), part(body.faces, body.start);
    whole.refit(body.boxes(1e-3), pool);
    std::size_t pairs = 0;
    for (const double offset : {-0.9, 0.0, 0.9, 5.0}) {
      Soup cloth(200, 0.02, 0.01, 4);
      for (auto* points : {&cloth.start, &cloth.end}) {
        for (Vector3d& p : *points) p = Vector3d(0.2 * p.x() + offset, p.y(), p.z());
      }
      SweptBvh other(cloth.faces, cloth.start);
      other.refit(cloth.boxes(1e-3), pool);
      part.refit(body.boxes(1e-3), other);
      EXPECT_EQ(other.pairs(part), other.pairs(whole));
      pairs += other.pairs(whole).size();
    }
    if (count == 5000) {
      EXPECT_GT(pairs, 50u);
    }
    part.refit(body.boxes(1e-3), pool);
    EXPECT_EQ(part.self_pairs(pool, 10'000'000), whole.self_pairs(pool, 10'000'000));
  }
}

}  // namespace
}  // namespace pleat
