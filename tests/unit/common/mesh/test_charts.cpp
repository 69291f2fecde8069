// Islands as people lay them out: mirrored, on top of each other, far apart.
#include "common/mesh/charts.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/error.hpp"
#include "common/mesh/obj.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

const fs::path kCases = "tests/cases";

double uv_area(const Topology& t, Eigen::Index f) {
  const Eigen::Vector2d a = t.uv.row(t.uv_faces(f, 0)).cast<double>(), b = t.uv.row(t.uv_faces(f, 1)).cast<double>(),
                        c = t.uv.row(t.uv_faces(f, 2)).cast<double>();
  return ((b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x())) / 2;
}

/// Lengths of all edges in material space, face by face.
std::vector<double> lengths(const Topology& t) {
  std::vector<double> result;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      result.push_back(static_cast<double>((t.uv.row(t.uv_faces(f, k)) - t.uv.row(t.uv_faces(f, (k + 1) % 3))).norm()));
    }
  }
  return result;
}

void expect_usable(const fs::path& file, std::size_t notes_expected) {
  Topology t = read_obj(file);
  const std::vector<double> before = lengths(t);
  std::vector<std::string> notes;
  prepare_garment(t, file.string(), notes);
  EXPECT_EQ(notes.size(), notes_expected) << file;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) ASSERT_GT(uv_area(t, f), 0) << file;
  EXPECT_FALSE(find_overlap(t, false)) << file;
  EXPECT_FALSE(find_overlap(t, true)) << file;
  EXPECT_THAT(lengths(t), testing::Pointwise(testing::DoubleNear(1e-5), before)) << file;
  // What was made ready is left alone.
  const std::string hash = topology_hash(t);
  notes.clear();
  prepare_garment(t, file.string(), notes);
  EXPECT_EQ(topology_hash(t), hash) << file;
  EXPECT_TRUE(notes.empty()) << file;
}

TEST(Charts, MirroredIslandsAreTurnedOver) {
  expect_usable(kCases / "09-garment-mirrored-panel" / "skirt.obj", 1);
  expect_usable(kCases / "09-garment-mirrored-panel" / "skirt-all-mirrored.obj", 1);
}

TEST(Charts, IslandsThatOverlapAreLaidOutApart) {
  const fs::path file = kCases / "08-garment-uv-islands-overlap" / "skirt.obj";
  EXPECT_TRUE(find_overlap(read_obj(file), false));
  expect_usable(file, 1);
}

TEST(Charts, IslandsFarApartAreMovedTogether) {
  expect_usable(kCases / "32-gap-between-uv-panels" / "skirt-panels-20cm-apart.obj", 1);
  expect_usable(kCases / "32-gap-between-uv-panels" / "flat-cloth-two-panels.obj", 1);
}

TEST(Charts, GarmentsAsTheyShouldBeKeepTheirBits) {
  for (const char* file : {"deploy/garments/tablecloth.obj", "deploy/garments/skirt.obj"}) {
    Topology t = read_obj(fs::path(file));
    const std::string hash = topology_hash(t);
    std::vector<std::string> notes;
    prepare_garment(t, file, notes);
    EXPECT_EQ(topology_hash(t), hash) << file;
    EXPECT_TRUE(notes.empty()) << file;
  }
}

TEST(Charts, AFoldInsideAnIslandIsAnError) {
  Topology t;
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0;
  t.faces.resize(2, 3);
  t.faces << 0, 1, 2, 1, 3, 2;
  t.uv.resize(4, 2);
  t.uv << 0, 0, 1, 0, 0, 1, 0.1f, 0.1f;
  t.uv_faces = t.faces;
  std::vector<std::string> notes;
  EXPECT_THROW(prepare_garment(t, "x", notes), Error);
  // A strip that winds over itself without a fold.
  t.rest_positions.resize(10, 3);
  t.uv.resize(10, 2);
  t.faces.resize(8, 3);
  for (int i = 0; i < 5; ++i) {
    const float angle = 1.9f * static_cast<float>(i);
    t.uv.row(2 * i) << std::cos(angle), std::sin(angle);
    t.uv.row(2 * i + 1) << 2 * std::cos(angle), 2 * std::sin(angle);
    t.rest_positions.row(2 * i) << t.uv.row(2 * i), static_cast<float>(i);
    t.rest_positions.row(2 * i + 1) << t.uv.row(2 * i + 1), static_cast<float>(i);
  }
  for (std::uint32_t i = 0; i < 4; ++i) {
    t.faces.row(2 * i) << 2 * i, 2 * i + 1, 2 * i + 2;
    t.faces.row(2 * i + 1) << 2 * i + 1, 2 * i + 3, 2 * i + 2;
  }
  t.uv_faces = t.faces;
  EXPECT_THROW(prepare_garment(t, "x", notes), Error);
}

}  // namespace
}  // namespace pleat
