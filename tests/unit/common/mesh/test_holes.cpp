// Open bodies and sheets become closed, and nothing else changes.
#include "common/mesh/holes.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <random>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/obj.hpp"

namespace pleat {
namespace {

const std::filesystem::path kCase = "tests/cases/18-body-mesh-with-holes";

bool is_closed(const Topology& t) {
  const Connectivity c = build_connectivity(t.vertex_count(), t.faces);
  return std::all_of(c.edges.begin(), c.edges.end(), [](const Edge& edge) { return edge.f1 != kNone; });
}

double volume(const Topology& t) {
  double sum = 0;
  for (Eigen::Index f = 0; f < t.face_count(); ++f) {
    const Eigen::Vector3d a = t.rest_positions.row(t.faces(f, 0)).cast<double>().transpose();
    const Eigen::Vector3d b = t.rest_positions.row(t.faces(f, 1)).cast<double>().transpose();
    const Eigen::Vector3d c = t.rest_positions.row(t.faces(f, 2)).cast<double>().transpose();
    sum += a.dot(b.cross(c)) / 6;
  }
  return sum;
}

TEST(Holes, BodiesGetLids) {
  const Topology whole = read_obj(kCase / "closed.obj", MeshUse::kObstacle);
  for (const char* file : {"small-hole.obj", "open-neck.obj"}) {
    const Topology open = read_obj(kCase / file, MeshUse::kObstacle);
    EXPECT_FALSE(is_closed(open)) << file;
    std::vector<std::string> notes;
    const Topology closed = close_holes(open, true, file, notes);
    EXPECT_TRUE(is_closed(closed)) << file;
    EXPECT_EQ(closed.rest_positions, open.rest_positions) << file;
    EXPECT_EQ(notes.size(), 1u) << file;
    EXPECT_NO_THROW(validate_topology(closed, file));
    EXPECT_GT(volume(closed), 0.5 * volume(whole)) << file;
    EXPECT_LT(volume(closed), 1.01 * volume(whole)) << file;
  }
  std::vector<std::string> notes;
  EXPECT_EQ(topology_hash(close_holes(whole, false, "closed", notes)), topology_hash(whole));
  EXPECT_TRUE(notes.empty());
}

TEST(Holes, ABodyThatIsInsideOutIsTurnedOver) {
  const Topology whole = read_obj(kCase / "closed.obj", MeshUse::kObstacle);
  for (const char* file : {"inside-out.obj", "small-hole.obj"}) {
    Topology body = read_obj(kCase / file, MeshUse::kObstacle);
    if (volume(body) > 0) body.faces.col(1).swap(body.faces.col(2));
    std::vector<std::string> notes;
    const Topology turned = close_holes(body, true, file, notes);
    EXPECT_NEAR(volume(turned), volume(whole), 0.01 * volume(whole)) << file;
    ASSERT_FALSE(notes.empty());
    EXPECT_NE(notes.back().find("look inwards"), std::string::npos) << notes.back();
    EXPECT_NO_THROW(validate_topology(turned, file));
  }
}

TEST(Holes, ASheetBecomesASlabBehindIt) {
  for (const bool upside_down : {false, true}) {
    Topology ground = read_obj(kCase / "ground-quad.obj", MeshUse::kObstacle);
    if (upside_down) ground.faces.col(0).swap(ground.faces.col(1));
    std::vector<std::string> notes;
    const Topology slab = close_holes(ground, false, "ground", notes);
    EXPECT_TRUE(is_closed(slab));
    EXPECT_EQ(notes.size(), 1u);
    EXPECT_NO_THROW(validate_topology(slab, "slab"));
    EXPECT_GT(volume(slab), 0);
    EXPECT_FLOAT_EQ(slab.rest_positions.col(1).maxCoeff(), ground.rest_positions.col(1).maxCoeff());
    EXPECT_LE(slab.rest_positions.col(1).minCoeff(), ground.rest_positions.col(1).minCoeff() - 0.05f);
    // Where an animation names its vertices it stays a sheet.
    EXPECT_EQ(close_holes(ground, true, "ground", notes).vertex_count(), 4);
  }
}

TEST(Holes, AnyFacesMayBeMissing) {
  const Topology whole = read_obj(kCase / "closed.obj", MeshUse::kObstacle);
  std::mt19937 random(11);
  int closed = 0;
  for (int round = 0; round < 100; ++round) {
    Topology open = whole;
    const Eigen::Index missing = 1 + round % 4;
    for (Eigen::Index k = 0; k < missing; ++k) {
      const auto face = static_cast<Eigen::Index>(random() % static_cast<unsigned>(open.face_count()));
      open.faces.row(face).swap(open.faces.row(open.face_count() - 1));
      open.faces.conservativeResize(open.face_count() - 1, 3);
    }
    std::vector<std::string> notes;
    const Topology mended = close_holes(open, true, "body", notes);
    EXPECT_NO_THROW(validate_topology(mended, "body"));
    closed += is_closed(mended) ? 1 : 0;
  }
  EXPECT_GE(closed, 95);  // holes that touch in a vertex may stay
}

}  // namespace
}  // namespace pleat
