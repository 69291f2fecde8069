#include "services/dataset/family_garments.hpp"

#include <gtest/gtest.h>

#include <set>
#include <string>

#include "common/mesh/charts.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/garment.hpp"
#include "services/conversion/representation.hpp"

namespace pleat::dataset {
namespace {

/// Borders of a mesh by walking along edges with one face.
std::size_t count_borders(const Topology& mesh) {
  std::vector<std::uint32_t> next(static_cast<std::size_t>(mesh.vertex_count()), ~0U);
  std::set<std::pair<std::uint32_t, std::uint32_t>> sides;
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    for (Eigen::Index k = 0; k < 3; ++k) sides.insert({mesh.faces(f, k), mesh.faces(f, (k + 1) % 3)});
  }
  for (const auto& [a, b] : sides) {
    if (sides.count({b, a}) == 0) next[a] = b;
  }
  std::size_t count = 0;
  for (std::uint32_t v = 0; v < next.size(); ++v) {
    if (next[v] == ~0U) continue;
    ++count;
    for (std::uint32_t at = v; next[at] != ~0U;) at = std::exchange(next[at], ~0U);
  }
  return count;
}

TEST(FamilyGarments, AreGarments) {
  std::set<std::string> shapes;
  for (std::size_t i = 0; i < 3 * kFamilyKinds; ++i) {
    Random random(100 + i);
    const FamilyGarment garment = family_garment(i, random);
    SCOPED_TRACE(std::to_string(i) + ": " + garment.shape);
    shapes.insert(garment.shape.substr(0, garment.shape.find(' ')));
    const Topology& mesh = garment.mesh;
    validate_topology(mesh, "garment");
    validate_material_coordinates(mesh, "garment");
    require_rest_lengths(mesh, "garment");
    EXPECT_GT(mesh.vertex_count(), 90);
    EXPECT_LT(mesh.vertex_count(), 600);
    EXPECT_NEAR(mean_edge_length(mesh), garment.edge, 0.25 * garment.edge);
    // Flat pieces lose nothing in the plane; rings are bent along chords, which are a little shorter.
    const EdgeRatios ratios = material_ratios(mesh);
    EXPECT_NEAR(ratios.median, 1, garment.ring ? 0.08 : 1e-4);

    EXPECT_EQ(count_borders(mesh), garment.ring ? 2U : 1U);
    ASSERT_EQ(garment.borders.size(), garment.ring ? 2U : 1U);
    const Connectivity connectivity = build_connectivity(mesh.vertex_count(), mesh.faces);
    std::set<std::uint32_t> rim, named;
    for (const Edge& edge : connectivity.edges) {
      if (edge.f1 == kNone) rim.insert({edge.v0, edge.v1});
    }
    for (const auto& border : garment.borders) named.insert(border.begin(), border.end());
    EXPECT_EQ(named, rim);
    if (garment.ring) {
      EXPECT_GT(mesh.rest_positions(garment.borders[0][0], 1), mesh.rest_positions(garment.borders[1][0], 1));
      EXPECT_GT(mesh.uv.rows(), mesh.vertex_count()) << "seams have two sides";
    }
    // Conversion takes it: charts beside each other, none folded.
    conversion::RepresentationSpec spec;
    spec.kind = conversion::GeometryImageSpec{.layout = conversion::ImageLayout::kDetail};
    EXPECT_NO_THROW(conversion::make_representation(mesh, spec));
  }
  EXPECT_EQ(shapes.size(), 9u);
}

TEST(FamilyGarments, FollowFromTheSeed) {
  for (const std::size_t kind : {0, 1, 4}) {
    Random a(5), b(5), c(6);
    const std::string hash = topology_hash(family_garment(kind, a).mesh);
    EXPECT_EQ(hash, topology_hash(family_garment(kind, b).mesh));
    EXPECT_NE(hash, topology_hash(family_garment(kind, c).mesh));
  }
}

}  // namespace
}  // namespace pleat::dataset
