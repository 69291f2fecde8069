#include "common/mesh/bvh.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "common/base/error.hpp"

namespace pleat {
namespace {

std::vector<Box> random_boxes(std::size_t count, double size, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<double> position(-1, 1), extent(0, size);
  std::vector<Box> boxes(count);
  for (Box& box : boxes) {
    const Eigen::Vector3d p(position(engine), position(engine), position(engine));
    box.extend(p);
    box.extend(p + Eigen::Vector3d(extent(engine), extent(engine), extent(engine)));
  }
  return boxes;
}

std::vector<Bvh::Pair> brute_force(const std::vector<Box>& boxes) {
  std::vector<Bvh::Pair> pairs;
  for (std::uint32_t i = 0; i < boxes.size(); ++i) {
    for (std::uint32_t j = i + 1; j < boxes.size(); ++j) {
      if (boxes[i].overlaps(boxes[j])) pairs.push_back({i, j});
    }
  }
  return pairs;
}

std::vector<Bvh::Pair> sorted(std::vector<Bvh::Pair> pairs) {
  std::sort(pairs.begin(), pairs.end());
  return pairs;
}

TEST(Box, ContainsItsPointsAfterRounding) {
  std::mt19937 engine(1);
  std::uniform_real_distribution<double> position(-100, 100);
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector3d p(position(engine), 1e-12 * position(engine), 1e6 * position(engine));
    Box box;
    box.extend(p);
    for (int k = 0; k < 3; ++k) {
      EXPECT_LE(static_cast<double>(box.lower[k]), p[k]);
      EXPECT_GE(static_cast<double>(box.upper[k]), p[k]);
    }
  }
}

TEST(Box, OverlapsInEveryAxisOrNotAtAll) {
  Box a;
  a.extend(Eigen::Vector3d::Zero());
  a.extend(Eigen::Vector3d::Ones());
  for (int axis = 0; axis < 3; ++axis) {
    Box b = a;
    EXPECT_TRUE(a.overlaps(b));
    b.lower[axis] += 2;
    b.upper[axis] += 2;
    EXPECT_FALSE(a.overlaps(b));
    EXPECT_FALSE(b.overlaps(a));
  }
}

std::vector<Bvh::Pair> self_pairs(const Bvh& bvh) {
  std::vector<Bvh::Pair> visited;
  EXPECT_TRUE(bvh.visit_self_pairs([&](std::uint32_t i, std::uint32_t j) {
    visited.push_back({i, j});
    return true;
  }));
  return sorted(visited);
}

TEST(Bvh, SelfPairsAgreeWithBruteForce) {
  for (const std::size_t count : {1u, 2u, 3u, 17u, 800u}) {
    const auto boxes = random_boxes(count, 0.2, static_cast<unsigned>(count));
    const Bvh bvh(boxes);
    EXPECT_EQ(self_pairs(bvh), brute_force(boxes));
  }
}

TEST(Bvh, PartsOfTheTraversalGiveEveryPairOnce) {
  for (const std::size_t count : {1u, 2u, 5u, 700u}) {
    Bvh bvh(random_boxes(count, 0.2, 3));
    for (const int levels : {0, 1, 4}) {
      const auto parts = bvh.self_pair_parts(levels);
      const auto boxes = random_boxes(count, 0.2, 7);  // the parts do not depend on the boxes
      bvh.refit(boxes);
      EXPECT_EQ(bvh.self_pair_parts(levels), parts);
      std::vector<Bvh::Pair> visited, stack;
      for (const Bvh::Pair& part : parts) {
        bvh.visit_self_pairs(part, stack, [&](std::uint32_t i, std::uint32_t j) {
          visited.push_back({i, j});
          return true;
        });
      }
      EXPECT_EQ(sorted(visited), brute_force(boxes)) << count << " boxes, " << levels << " levels";
    }
  }
}

TEST(Bvh, GroupsHoldAllElementsOnceAndAreNear) {
  for (const std::size_t count : {1u, 7u, 8u, 9u, 100u, 4096u}) {
    const auto boxes = random_boxes(count, 0, 5);
    const std::vector<std::uint32_t> order = near_groups(boxes, 8);
    std::vector<std::uint32_t> elements(order);
    std::sort(elements.begin(), elements.end());
    ASSERT_EQ(elements.size(), count);
    for (std::uint32_t i = 0; i < count; ++i) EXPECT_EQ(elements[i], i);
    double groups = 0;
    Box all;
    for (std::size_t begin = 0; begin < count; begin += 8) {
      Box group;
      for (std::size_t i = begin; i < std::min(begin + 8, count); ++i) group.extend(boxes[order[i]]);
      for (int k = 0; k < 3; ++k) groups += static_cast<double>(group.upper[k] - group.lower[k]);
      all.extend(group);
    }
    double whole = 0;
    for (int k = 0; k < 3; ++k) whole += static_cast<double>(all.upper[k] - all.lower[k]);
    // 512 groups of a cube are an eighth as long as it, or little more.
    if (count == 4096) {
      EXPECT_LT(groups / 512, whole / 6);
    }
  }
}

TEST(Box, WidenedByAMargin) {
  const auto boxes = random_boxes(50, 0.2, 3);
  const Box wide = widened(boxes[0], 0.125);
  for (int k = 0; k < 3; ++k) {
    EXPECT_LE(wide.lower[k], boxes[0].lower[k] - 0.125f);
    EXPECT_GE(wide.upper[k], boxes[0].upper[k] + 0.125f);
    EXPECT_NEAR(wide.lower[k], boxes[0].lower[k] - 0.125f, 1e-5);
    EXPECT_NEAR(wide.upper[k], boxes[0].upper[k] + 0.125f, 1e-5);
  }
}

// Far from the origin, where a float is as coarse as the boxes are small, and with boxes that are points.
TEST(Bvh, NearestMissesNothingWhereFloatsAreCoarse) {
  for (const double offset : {0.0, 1000.0, 1e5}) {
    std::vector<Box> boxes(300);
    std::mt19937 engine(5);
    std::uniform_real_distribution<double> position(-1, 1);
    for (Box& box : boxes) box.extend(Eigen::Vector3d(offset + position(engine), position(engine), -offset));
    const Bvh bvh(boxes);
    for (int i = 0; i < 200; ++i) {
      const Eigen::Vector3d p(offset + position(engine), position(engine), 0.01 * position(engine) - offset);
      double expected = 1e9, best = 1e9;
      for (const Box& box : boxes) expected = std::min(expected, squared_distance(box, p));
      bvh.nearest(p, best, [&](std::uint32_t e) { return best = std::min(best, squared_distance(boxes[e], p)); });
      EXPECT_EQ(best, expected) << offset;
    }
  }
}

TEST(Bvh, NearestVisitsTheNearestAndLittleElse) {
  const auto boxes = random_boxes(2000, 0.02, 11);
  const Bvh bvh(boxes);
  std::mt19937 engine(12);
  std::uniform_real_distribution<double> position(-1.5, 1.5);
  std::size_t visits = 0;
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d p(position(engine), position(engine), position(engine));
    double expected = 1e9;
    for (const Box& box : boxes) expected = std::min(expected, squared_distance(box, p));
    double best = 1e9;
    bvh.nearest(p, best, [&](std::uint32_t e) {
      ++visits;
      return best = std::min(best, squared_distance(boxes[e], p));
    });
    EXPECT_EQ(best, expected);
    bool any = false;
    bvh.nearest(p, 0.9 * expected, [&](std::uint32_t) {
      any = true;
      return 0.0;
    });
    EXPECT_EQ(any, expected == 0);  // nothing is nearer than the bound
  }
  EXPECT_LT(visits, 200u * 40u);
  Bvh().nearest({0, 0, 0}, 1, [](std::uint32_t) -> double { throw std::logic_error("nothing to visit"); });
}

TEST(Bvh, RefitFollowsMovedBoxes) {
  Bvh bvh(random_boxes(500, 0.1, 3));
  const auto moved = random_boxes(500, 0.3, 4);  // a tree built for other places must still be right
  bvh.refit(moved);
  EXPECT_EQ(self_pairs(bvh), brute_force(moved));
  EXPECT_THROW(bvh.refit(std::span(moved).first(499)), Error);
}

TEST(Bvh, Queries) {
  const auto a = random_boxes(300, 0.2, 5), b = random_boxes(200, 0.2, 6);
  const Bvh bvh_b(b);
  for (std::uint32_t i = 0; i < a.size(); ++i) {
    std::vector<std::uint32_t> found, near;
    bvh_b.query(a[i], [&](std::uint32_t j) { found.push_back(j); });
    for (std::uint32_t j = 0; j < b.size(); ++j) {
      if (!a[i].overlaps(b[j])) continue;
      near.push_back(j);
    }
    std::sort(found.begin(), found.end());
    EXPECT_EQ(found, near);
  }
  EXPECT_TRUE(self_pairs(Bvh()).empty());
}

TEST(Bvh, TheVisitorEndsTheTraversalOfACollapsedMesh) {
  const Bvh bvh(std::vector<Box>(3000, random_boxes(1, 0.5, 1)[0]));
  std::size_t visits = 0;
  EXPECT_FALSE(bvh.visit_self_pairs([&](std::uint32_t, std::uint32_t) { return ++visits < 10000; }));
  EXPECT_EQ(visits, 10000u);
}

}  // namespace
}  // namespace pleat
