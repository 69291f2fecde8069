#include "services/fold/constraints.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <numeric>
#include <set>

#include "common/mesh/connectivity.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

class ConstraintsTest : public testing::Test {
 protected:
  ConstraintsTest() : mesh(simulation::sheet(6, 4, 0.6, 0.4)), count(static_cast<std::uint32_t>(mesh.vertex_count())) {
    for (const float mass : lumped_masses(mesh, 0.2)) inverse_masses.push_back(1 / mass);
    for (std::uint32_t v = 0; v < count; ++v) x.push_back(to_float4(mesh.rest_positions.row(v).transpose()));
    x.push_back(Float4{});
  }

  static float length(Float4 d) { return std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]); }

  Topology mesh;
  std::uint32_t count;
  simulation::Material material = simulation::plain_material(60, 2e-5);
  std::vector<float> inverse_masses;
  std::vector<Float4> x;
};

TEST_F(ConstraintsTest, MassesAreThoseOfTheSheet) {
  const auto masses = lumped_masses(mesh, 0.2);
  EXPECT_NEAR(std::accumulate(masses.begin(), masses.end(), 0.0), 0.2 * 0.6 * 0.4, 1e-6);
}

TEST_F(ConstraintsTest, NothingMovesAtRest) {
  const std::vector<Float4> before = x;
  FacePacks faces(stretch_faces(mesh, material), count);
  HingePacks hinges(edge_hinges(mesh, material), count);
  faces.set_step(inverse_masses, 0.002f);
  hinges.set_step(inverse_masses, 0.002f);
  faces.solve(x, false);
  hinges.solve(x);
  for (std::uint32_t v = 0; v < count; ++v) EXPECT_LT(length(x[v] - before[v]), 1e-6f);
}

TEST_F(ConstraintsTest, APackHasNoVertexTwice) {
  const auto hinges = edge_hinges(mesh, material);
  std::size_t packed = 0;
  for (const auto& members : independent_packs(std::span<const Hinge>(hinges))) {
    std::set<std::uint32_t> vertices;
    for (const std::uint32_t m : members) vertices.insert(hinges[m].v.begin(), hinges[m].v.end());
    EXPECT_EQ(vertices.size(), 4 * members.size());
    EXPECT_LE(members.size(), kLanes);
    packed += members.size();
  }
  EXPECT_EQ(packed, hinges.size());
}

/// One face with moduli of its own.
class FaceTest : public testing::Test {
 protected:
  static constexpr float kStep = 0.003f;
  FaceTest() : face{{0, 1, 2}, {70, -20}, {-10, 60}, 1.5e-4f, {40, 12, 70, 30}, {40, 12, 70, 30}} {}

  static Eigen::Vector3d at(Float4 p) { return {double{p[0]}, double{p[1]}, double{p[2]}}; }
  static Eigen::Vector3d strains(const Face& f, const std::vector<Float4>& y) {
    const Eigen::Vector3d e1 = at(y[1]) - at(y[0]), e2 = at(y[2]) - at(y[0]);
    const Eigen::Vector3d u = double{f.du[0]} * e1 + double{f.du[1]} * e2,
                          v = double{f.dv[0]} * e1 + double{f.dv[1]} * e2;
    return {(u.squaredNorm() - 1) / 2, (v.squaredNorm() - 1) / 2, u.dot(v) / 2};
  }
  // Positions at which the face has the deformation gradient (x_u, x_v).
  std::vector<Float4> placed(const Eigen::Vector3d& u, const Eigen::Vector3d& v) const {
    Eigen::Matrix2d inverse;
    inverse << double{face.du[0]}, double{face.dv[0]}, double{face.du[1]}, double{face.dv[1]};
    Eigen::Matrix<double, 3, 2> gradient;
    gradient << u, v;
    const Eigen::Matrix<double, 3, 2> edges = gradient * inverse.inverse();
    const Eigen::Vector3d corner(0.3, -0.2, 0.1);
    return {to_float4(corner), to_float4(corner + edges.col(0)), to_float4(corner + edges.col(1)), Float4{}};
  }

  Face face;
  const std::vector<float> mobility{9000, 7000, 12000};
};

// XPBD with the strains' derivatives by central differences and a dense solve.
TEST_F(FaceTest, MovesItsCornersByTheStrainsTogether) {
  std::vector<Float4> y = placed({1.08, 0.1, -0.05}, {0.12, 0.2, 0.99});
  Eigen::Matrix<double, 3, 9> jacobian;
  for (int k = 0; k < 9; ++k) {
    const auto shifted = [&](float by) {
      std::vector<Float4> z = y;
      z[static_cast<std::size_t>(k / 3)][k % 3] += by;
      return strains(face, z);
    };
    const float d = 1e-4f;
    const float there = y[static_cast<std::size_t>(k / 3)][k % 3];
    jacobian.col(k) = (shifted(d) - shifted(-d)) / double{(there + d) - (there - d)};
  }
  Eigen::Matrix3d stiffness = Eigen::Matrix3d::Zero();
  stiffness << double{face.rest.c11}, double{face.rest.c12}, 0, double{face.rest.c12}, double{face.rest.c22}, 0, 0, 0,
      2 * double{face.rest.c33};
  stiffness *= double{face.area} * double{kStep} * double{kStep};
  Eigen::Matrix<double, 9, 1> w;
  for (int k = 0; k < 9; ++k) w[k] = double{mobility[static_cast<std::size_t>(k / 3)]};
  const Eigen::Matrix3d system = jacobian * w.asDiagonal() * jacobian.transpose() + stiffness.inverse();
  const Eigen::Matrix<double, 9, 1> move =
      -(w.asDiagonal() * jacobian.transpose() * system.inverse()) * strains(face, y);
  const std::vector<Float4> before = y;
  FacePacks packs({face}, 3);
  packs.set_step(mobility, kStep);
  packs.solve(y, false);
  ASSERT_GT(move.norm(), 1e-4);
  for (int k = 0; k < 9; ++k) {
    const auto corner = static_cast<std::size_t>(k / 3);
    EXPECT_NEAR(double{y[corner][k % 3]} - double{before[corner][k % 3]}, move[k], 2e-3 * move.norm()) << k;
  }
}

TEST_F(FaceTest, OnlyItsStretchIsSolvedIfAsked) {
  FacePacks packs({face}, 3);
  packs.set_step(mobility, kStep);
  // Too short every way: it stays.
  std::vector<Float4> y = placed({0.9, 0, 0}, {0.02, 0, 0.95}), before = y;
  packs.solve(y, true);
  for (std::size_t k = 0; k < 3; ++k) EXPECT_LT((at(y[k]) - at(before[k])).norm(), 1e-6);
  packs.solve(y, false);
  EXPECT_GT((at(y[0]) - at(before[0])).norm(), 1e-5);
  // Too long every way: as if not asked.
  y = placed({1.1, 0, 0}, {0.02, 0, 1.05});
  std::vector<Float4> both = y;
  packs.solve(y, true);
  packs.solve(both, false);
  for (std::size_t k = 0; k < 3; ++k) EXPECT_LT((at(y[k]) - at(both[k])).norm(), 1e-6);
}

TEST_F(FaceTest, FixedCornersStay) {
  FacePacks packs({face}, 3);
  packs.set_step(std::vector<float>{0, 7000, 0}, kStep);
  std::vector<Float4> y = placed({1.1, 0, 0}, {0.02, 0, 1.05}), before = y;
  packs.solve(y, false);
  EXPECT_EQ(at(y[0]), at(before[0]));
  EXPECT_EQ(at(y[2]), at(before[2]));
  EXPECT_NE(at(y[1]), at(before[1]));
}

// Pulled along u, a sheet without c12 keeps its width: springs along the edges would make it narrower.
TEST_F(ConstraintsTest, APulledSheetWithoutCrossModulusKeepsItsWidth) {
  FacePacks faces(stretch_faces(mesh, material), count);
  std::vector<float> mobile = inverse_masses;
  for (std::uint32_t v = 0; v < count; ++v) {
    if (std::abs(x[v][0]) < 0.299f) continue;
    x[v][0] *= 1.1f;
    mobile[v] = 0;
  }
  const std::vector<Float4> start = x;
  faces.set_step(mobile, 0.001f);  // so short that passes descend the energy
  for (int k = 0; k < 4000; ++k) faces.solve(x, false);
  float stretched = 0, narrowed = 0;
  for (std::uint32_t v = 0; v < count; ++v) {
    stretched = std::max(stretched, std::abs(x[v][0] - start[v][0]));
    narrowed = std::max({narrowed, std::abs(x[v][1] - start[v][1]), std::abs(x[v][2] - start[v][2])});
  }
  EXPECT_GT(stretched, 0.01f);
  EXPECT_LT(narrowed, 0.1f * stretched);
}

// The length of a hinge's sum is the angle between its faces, wherever the hinge is and however it is turned.
TEST_F(ConstraintsTest, AHingesSumIsItsAngle) {
  const double angle = 0.2;
  for (std::uint32_t v = 0; v < count; ++v) {  // folded along the line x = 0 of material coordinates
    const float along = mesh.rest_positions(v, 0);
    if (along > 0) {
      x[v][0] = along * static_cast<float>(std::cos(angle));
      x[v][1] += along * static_cast<float>(std::sin(angle));
    }
  }
  double bent = 0;
  for (const Hinge& hinge : edge_hinges(mesh, material)) {
    Float4 sum{};
    for (std::size_t k = 0; k < 4; ++k) sum += hinge.weights[k] * x[hinge.v[k]];
    bent = std::max(bent, static_cast<double>(length(sum)));
  }
  EXPECT_NEAR(bent, 2 * std::sin(angle / 2), 0.05 * angle);
}

TEST_F(ConstraintsTest, HingesFlattenAndKeepMomentum) {
  HingePacks hinges(edge_hinges(mesh, material), count);
  hinges.set_step(inverse_masses, 1);  // long enough to be hard
  for (std::uint32_t v = 0; v < count; ++v) x[v][1] = 5e-3f * std::cos(40 * x[v][0]) * std::cos(30 * x[v][2]);
  const auto roughness = [&] {
    double sum = 0;
    for (std::uint32_t v = 0; v < count; ++v) sum += static_cast<double>(x[v][1]) * static_cast<double>(x[v][1]);
    return sum;
  };
  const auto momentum = [&] {
    double sum = 0;
    for (std::uint32_t v = 0; v < count; ++v) {
      sum += static_cast<double>(x[v][1]) / static_cast<double>(inverse_masses[v]);
    }
    return sum;
  };
  const double rough = roughness(), before = momentum();
  for (int k = 0; k < 50; ++k) hinges.solve(x);
  EXPECT_LT(roughness(), 0.5 * rough);
  EXPECT_NEAR(momentum(), before, 1e-7);
}

}  // namespace
}  // namespace pleat::fold
