#include "services/refinement/cloth_contacts.hpp"

#include <gtest/gtest.h>

#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

// Three cloths in one mesh: a wavy sheet across the obstacles, a small one wholly inside the torus, one far away.
struct Scene {
  Topology coarse = test::square_sheet(6, 1);
  Faces faces;
  Faces patch_corners;
  Positions positions;
  std::vector<ObstacleShape> shapes;
  std::vector<ObstacleFrame> frames;
};

Scene scene(unsigned seed) {
  Scene s;
  const Subdivision fine = subdivide(s.coarse, 2);
  const Eigen::Index v = fine.fine.vertex_count(), f = fine.fine.face_count(), patches = s.coarse.face_count();
  s.faces.resize(3 * f, 3);
  s.patch_corners.resize(3 * patches, 3);
  s.positions.resize(3 * v, 3);
  for (Eigen::Index i = 0; i < 3; ++i) {
    s.faces.middleRows(i * f, f) = fine.fine.faces.array() + static_cast<std::uint32_t>(i * v);
    s.patch_corners.middleRows(i * patches, patches) = s.coarse.faces.array() + static_cast<std::uint32_t>(i * v);
  }
  Positions sheet = fine.fine.rest_positions;
  sheet.rowwise() += Eigen::RowVector3f(-0.5f, 0, 0.5f);
  s.positions.topRows(v) = 1.6f * sheet + test::noise(v, 0.03f, seed);
  s.positions.middleRows(v, v) = 0.08f * sheet + test::noise(v, 0.005f, seed + 1);
  s.positions.middleRows(v, v).col(0).array() += 0.5f;
  s.positions.bottomRows(v) = sheet;
  s.positions.bottomRows(v).col(1).array() += 3;
  const test::ClosedMesh torus = test::torus(0.5f, 0.2f, 64, 32);
  s.shapes = {{"torus", torus.faces}};
  ObstacleFrame ring;
  ring.name = "torus";
  ring.positions = torus.positions;
  s.frames = {ring, test::sphere("ball", {0.5f, 0.1f, 0.3f}, 0.25f)};
  return s;
}

class Contacts : public testing::TestWithParam<unsigned> {};
INSTANTIATE_TEST_SUITE_P(Seeds, Contacts, testing::Range(1u, 5u));

TEST_P(Contacts, AgreeWithAskingForEveryVertexAndFace) {
  const Scene s = scene(GetParam());
  ObstacleField field(s.shapes);
  field.update(s.frames);
  ThreadPool pool(2);
  SelfIntersectionFinder finder(s.faces, s.positions.rows(), s.patch_corners, &pool);
  finder.update(s.positions);
  ClothContacts contacts(s.faces, s.positions.rows(), &pool);
  contacts.update(s.positions, field, finder);

  std::vector<std::uint32_t> faces;
  contacts.find_penetrations(s.positions, field, finder, faces);
  EXPECT_EQ(faces, field.find(s.positions, s.faces));
  EXPECT_GT(faces.size(), 1000u);  // the sheet inside the torus, whole, and parts of the large one

  constexpr double kReach = 0.03;
  std::vector<VertexContact> found;
  contacts.find_contacts(s.positions, field, finder, kReach, found);
  std::size_t next = 0, inside = 0;
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(s.positions.rows()); ++v) {
    const auto expected = field.contact(s.positions.row(v).cast<double>(), kReach);
    if (!expected) continue;
    ASSERT_LT(next, found.size());
    EXPECT_EQ(found[next].vertex, v);
    EXPECT_EQ(found[next].contact.distance, expected->distance);
    EXPECT_EQ(found[next].contact.normal, expected->normal);
    inside += expected->distance < -kReach;
    ++next;
  }
  EXPECT_EQ(next, found.size());
  EXPECT_GT(inside, 100u);
}

TEST_P(Contacts, PenetrationsFollowMovedPatches) {
  Scene s = scene(GetParam());
  ObstacleField field(s.shapes);
  field.update(s.frames);
  SelfIntersectionFinder finder(s.faces, s.positions.rows(), s.patch_corners);
  finder.update(s.positions);
  ClothContacts contacts(s.faces, s.positions.rows(), nullptr);
  contacts.update(s.positions, field, finder);
  std::vector<std::uint32_t> faces;
  contacts.find_penetrations(s.positions, field, finder, faces);
  std::mt19937 random(GetParam());
  for (int i = 0; i < 8; ++i) {
    // One vertex of the large sheet, a corner of patches, and what hangs on it.
    const auto v = static_cast<std::uint32_t>(random() % 49);
    s.positions.row(v) += test::noise(1, 0.1f, static_cast<unsigned>(random())).row(0);
    finder.update(s.positions);
    contacts.find_penetrations_again(s.positions, field, finder, finder.patches_at(v), faces);
    EXPECT_EQ(faces, field.find(s.positions, s.faces));
  }
}

}  // namespace
}  // namespace pleat::refinement
