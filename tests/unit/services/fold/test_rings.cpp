#include "services/fold/rings.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

// Read off the faces: an edge on the border belongs to one of them.
std::set<std::uint32_t> neighbours(const Topology& mesh, std::uint32_t vertex, bool border_alone) {
  std::multiset<std::uint32_t> all;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const auto face = mesh.faces.row(f);
    if ((face.array() != vertex).all()) continue;
    for (int k = 0; k < 3; ++k)
      if (face[k] != vertex) all.insert(face[k]);
  }
  std::set<std::uint32_t> result;
  for (const std::uint32_t other : all)
    if (!border_alone || all.count(other) == 1) result.insert(other);
  return result;
}

TEST(Rings, AreTheNeighbours) {
  const Topology mesh = simulation::sheet(4, 3, 0.4, 0.3);
  const Rings all(mesh), along(mesh, Rings::kAlongBorders);
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(mesh.vertex_count()); ++v) {
    const std::span<const std::uint32_t> ring = all.of(v), border = along.of(v);
    EXPECT_EQ(std::set<std::uint32_t>(ring.begin(), ring.end()), neighbours(mesh, v, false)) << v;
    EXPECT_EQ(ring.size(), neighbours(mesh, v, false).size()) << v;
    const std::set<std::uint32_t> outside = neighbours(mesh, v, true);
    EXPECT_EQ(std::set<std::uint32_t>(border.begin(), border.end()),
              outside.empty() ? neighbours(mesh, v, false) : outside)
        << v;
  }
}

}  // namespace
}  // namespace pleat::fold
