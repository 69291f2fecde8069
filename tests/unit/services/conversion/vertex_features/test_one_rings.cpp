#include "services/conversion/vertex_features/one_rings.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <set>

#include "tests/support/errors.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

// The definition, in double, without order or packs. Weights are the library's own: they have a test of theirs.
Eigen::Matrix3d gradient_by_definition(const Topology& t, const OneRings& rings, const Positions& p, std::uint32_t i) {
  const auto normal = [&](const Positions& x) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (Eigen::Index f = 0; f < t.face_count(); ++f) {
      if ((t.faces.row(f).array() != i).all()) continue;
      const Eigen::Matrix3d c = x(t.faces.row(f).transpose().cast<Eigen::Index>().eval(), Eigen::all).cast<double>();
      sum += (c.row(1) - c.row(0)).cross(c.row(2) - c.row(0)).normalized().transpose();
    }
    return Eigen::Vector3d(sum.normalized());
  };
  Eigen::Matrix3d moved = Eigen::Matrix3d::Zero(), rest = Eigen::Matrix3d::Zero();
  double rest_length = 0, length = 0, count = 0;
  for (const auto& e : rings.edges()) {
    if (e.a != i && e.b != i) continue;
    const std::uint32_t j = e.a == i ? e.b : e.a;
    const Eigen::Vector3d r = (t.rest_positions.row(j) - t.rest_positions.row(i)).cast<double>();
    const Eigen::Vector3d d = (p.row(j) - p.row(i)).cast<double>();
    moved += static_cast<double>(e.weight) * d * r.transpose();
    rest += static_cast<double>(e.weight) * r * r.transpose();
    rest_length += r.norm();
    length += d.norm();
    ++count;
  }
  const Eigen::Vector3d n = normal(t.rest_positions) * 0.3 * rest_length / count, m = normal(p) * 0.3 * length / count;
  return (moved + m * n.transpose()) * (rest + n * n.transpose()).inverse();
}

TEST(OneRings, GradientsAreTheDefinition) {
  for (const char* name : {"skirt", "four charts"}) {
    const Topology t = test::load_garment(name).coarse;
    const OneRings rings(t, name);
    const Positions p = test::wrinkled_frame(t, 0.3f).positions;
    const GradientField field = test::gradients_of(rings, p);
    for (std::uint32_t v = 0; v < rings.vertex_count(); v += 7) {
      EXPECT_LT((field.at(v).cast<double>() - gradient_by_definition(t, rings, p, v)).norm(), 2e-5) << name << ' ' << v;
    }
  }
}

TEST(OneRings, WeightsFollowCotangents) {
  // Right triangles with legs of one edge: the diagonal has two right angles opposite, a leg inside two of 45 degrees,
  // and a leg on the boundary half of one.
  const OneRings rings(test::sheet(4, 4, 0.1f), "sheet");
  std::set<float> weights;
  for (const auto& e : rings.edges()) weights.insert(std::round(1e4f * e.weight) / 1e4f);
  EXPECT_EQ(weights, (std::set<float>{1.0f, std::round(1e4f * std::sqrt(1.5f)) / 1e4f,
                                      std::round(1e4f * std::sqrt(2.0f)) / 1e4f}));
}

TEST(OneRings, RigidMotionsAndScalesComeBackExactly) {
  const Topology t = test::load_garment("skirt").coarse;
  const OneRings rings(t, "skirt");
  const RigidTransform motion = test::some_motion();
  const Positions p = test::moved(Positions(1.5f * t.rest_positions), motion);
  const GradientField field = test::gradients_of(rings, p);
  for (std::size_t v = 0; v < rings.vertex_count(); ++v) {
    EXPECT_LT((field.at(v) - 1.5f * motion.rotation).norm(), 1e-4f) << v;
  }
}

TEST(OneRings, RefusesByName) {
  Topology alone = test::sheet(3, 3, 0.1f);
  alone.rest_positions.conservativeResize(10, 3);
  alone.rest_positions.row(9) << 5, 5, 5;
  EXPECT_THAT(test::error_of([&] { OneRings(alone, "shirt"); }).what(),
              ::testing::StartsWith("shirt: vertex 9 belongs"));
  Topology line = test::sheet(3, 3, 0.1f);
  line.rest_positions.col(2).setZero();
  EXPECT_THAT(test::error_of([&] { OneRings(line, "shirt"); }).what(),
              ::testing::StartsWith("shirt: vertex 0 has a coll"));

  std::vector<Float4> to;
  Positions p = test::sheet(3, 3, 0.1f).rest_positions;
  const auto load = [&] { load_positions(p, 9, 0, Eigen::Vector3f::Zero(), "frame", to); };
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e30f}) {
    p(4, 1) = bad;
    EXPECT_THAT(test::error_of(load).what(), ::testing::HasSubstr("position of vertex 4 ")) << bad;
  }
  p.conservativeResize(8, 3);
  EXPECT_EQ(test::error_of(load).code(), ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace pleat::conversion
