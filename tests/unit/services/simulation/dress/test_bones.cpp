#include "services/simulation/dress/bones.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <set>

#include "tests/unit/services/simulation/body/figures.hpp"

namespace pleat::dress {
namespace {

using Eigen::Vector3d;

/// A sleeve about the x axis from x = 0.4 to 1.6, radius 0.2, normals outwards: vertices of the opening at 0.4, then
/// those at 1.6.
Topology sleeve(int sides = 8) {
  Topology t;
  t.rest_positions.resize(2 * sides, 3);
  t.faces.resize(2 * sides, 3);
  for (int i = 0; i < sides; ++i) {
    const double angle = 2 * std::numbers::pi * i / sides;
    for (int end = 0; end < 2; ++end) {
      t.rest_positions.row(end * sides + i) << 0.4f + 1.2f * static_cast<float>(end),
          static_cast<float>(0.2 * std::cos(angle)), static_cast<float>(0.2 * std::sin(angle));
    }
    const auto a = static_cast<std::uint32_t>(i), b = static_cast<std::uint32_t>((i + 1) % sides);
    const auto n = static_cast<std::uint32_t>(sides);
    t.faces.row(2 * i) << a, b, a + n;
    t.faces.row(2 * i + 1) << b, b + n, a + n;
  }
  return t;
}

TEST(Bones, LeadToTheChildrenAndTheLastToTheFarthestSkin) {
  const body::SkinnedMesh tube = body::tube();  // joints at x = 0 and 1, skin from 0 to 2 at 0.1 around
  const std::vector<Bone> bones = bones_of(tube);
  ASSERT_EQ(bones.size(), 2u);
  EXPECT_EQ(bones[0].joint, 0);
  EXPECT_EQ(bones[0].from, Vector3d(0, 0, 0));
  EXPECT_EQ(bones[0].to, Vector3d(1, 0, 0));
  EXPECT_EQ(bones[1].joint, 1);
  EXPECT_EQ(bones[1].from, Vector3d(1, 0, 0));
  EXPECT_NEAR(bones[1].to.x(), 2, 1e-6);
}

TEST(Bones, NoneLeadsFromAJointThatNoSkinFollows) {
  body::SkinnedMesh tube = body::tube();
  for (body::Joint& joint : tube.skeleton.joints) ++joint.parent;
  tube.skeleton.joints.insert(tube.skeleton.joints.begin(), {"floor", -1, {0, -3, 0}, Eigen::Quaterniond::Identity()});
  tube.joints.array() += 1;
  for (const Bone& bone : bones_of(tube)) EXPECT_GT(bone.joint, 0);
}

TEST(Shrunk, GoesFromTheBonesToTheBody) {
  const body::SkinnedMesh tube = body::tube();
  const Shrunk shrunk(tube);
  EXPECT_EQ(shrunk.at(1), tube.mesh.rest_positions);
  const Positions bones = shrunk.at(0), half = shrunk.at(0.5);
  for (Eigen::Index v = 0; v < bones.rows(); ++v) {
    if (bones(v, 0) < 1) {
      EXPECT_LT(std::hypot(bones(v, 1), bones(v, 2)), 1e-6) << v;
    }
    EXPECT_LT((half.row(v) - (bones.row(v) + tube.mesh.rest_positions.row(v)) / 2).norm(), 1e-6) << v;
  }
}

TEST(Openings, AreTheLoopsOfTheBoundary) {
  const auto loops = openings(sleeve().faces);
  ASSERT_EQ(loops.size(), 2u);
  std::set<std::uint32_t> all;
  for (const auto& loop : loops) {
    EXPECT_EQ(loop.size(), 8u);
    for (std::size_t i = 0; i < loop.size(); ++i) {
      all.insert(loop[i]);
      // Neighbours in the loop are neighbours on the ring.
      const std::uint32_t a = loop[i] % 8, b = loop[(i + 1) % loop.size()] % 8;
      EXPECT_TRUE((a + 1) % 8 == b || (b + 1) % 8 == a);
    }
  }
  EXPECT_EQ(all.size(), 16u);
}

TEST(Placement, KnowsWhatIsAroundTheBones) {
  const Topology cloth = sleeve();
  const Placement placement(cloth.rest_positions, cloth.faces, bones_of(body::tube()));
  const Enclosure worn = placement.enclosure(Vector3d::Zero());
  EXPECT_EQ(worn.crossed, 0u);
  EXPECT_EQ(worn.pierced_count, 2u);
  EXPECT_NEAR(placement.outward_share(Vector3d::Zero()), 1, 1e-9);
  // Beside the bones, and so low that they leave through its side.
  EXPECT_EQ(placement.enclosure({0, 0.5, 0}).pierced_count, 0u);
  Topology slanted = cloth;
  slanted.rest_positions.col(1) += 0.5f * (slanted.rest_positions.col(0).array() - 1).matrix();
  EXPECT_GT(Placement(slanted.rest_positions, slanted.faces, bones_of(body::tube())).enclosure({0, 0, 0}).crossed, 0u);
  Topology turned = cloth;
  turned.faces.col(0).swap(turned.faces.col(1));
  EXPECT_NEAR(Placement(turned.rest_positions, turned.faces, bones_of(body::tube())).outward_share({0, 0, 0}), 0, 1e-9);
}

TEST(Placement, FindsAPlaceWithRoomNearby) {
  Topology cloth = sleeve();
  const auto place = [&cloth](double reach) {
    return Placement(cloth.rest_positions, cloth.faces, bones_of(body::tube())).nearest_worn(reach, 0.02);
  };
  EXPECT_EQ(place(0.1), Vector3d::Zero());
  cloth.rest_positions.col(1).array() += 0.25f;
  ASSERT_TRUE(place(0.2));
  // 5 cm until the bones are inside, and the room of 2.5 cm, on the grid.
  EXPECT_LT(place(0.2)->y(), -0.05);
  EXPECT_GT(place(0.2)->y(), -0.11);
  EXPECT_FALSE(place(0.03));
}

}  // namespace
}  // namespace pleat::dress
