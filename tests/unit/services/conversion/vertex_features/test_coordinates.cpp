#include "services/conversion/vertex_features/coordinates.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "common/mesh/subdivision.hpp"
#include "services/conversion/vertex_features/extraction.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/services/conversion/vertex_features/sheets.hpp"
#include "tests/unit/services/conversion/wrinkled_cloth.hpp"

namespace pleat::conversion {
namespace {

Positions rows(const Positions& p, const std::vector<std::uint32_t>& indices) {
  Positions result(static_cast<Eigen::Index>(indices.size()), 3);
  for (std::size_t k = 0; k < indices.size(); ++k) result.row(static_cast<Eigen::Index>(k)) = p.row(indices[k]);
  return result;
}

Positions solve(const CoordinateSolver& solver, const GradientField& gradients, const Positions& places, int passes) {
  CoordinateScratch scratch;
  Positions result;
  solver.solve(gradients, rows(places, solver.anchors().handles), rows(places, solver.anchors().soft), passes, scratch,
               result);
  return result;
}

TEST(Coordinates, RigidlyMovedAndScaledRestComesBack) {
  const Topology t = test::sheet(17, 13, 0.05f);
  const auto rings = test::rings_of(t);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(2, Eigen::Vector3f(1, 2, 2) / 3).matrix();
  const Positions p = (1.1f * t.rest_positions * turn.transpose()).rowwise() + Eigen::RowVector3f(1, 2, 3);
  const CoordinateSolver solver(rings, {{0, 16}, {}, 0.1}, "sheet");
  EXPECT_LT(test::rms(solve(solver, test::gradients_of(*rings, p), p, 0), p), 1e-5);
}

TEST(Coordinates, IsTheMinimumOfTheEnergy) {
  // L p = b(T) by finite differences: no direction from the answer lowers the energy.
  const Topology t = test::sheet(6, 5, 0.1f);
  const auto rings = test::rings_of(t);
  GradientField gradients = test::gradients_of(*rings, test::deform(t, test::waves));
  std::mt19937 random(3);
  std::normal_distribution<float> noise(0, 0.2f);
  for (auto& columns : gradients.columns) {
    for (Float4& column : columns) column += Float4{noise(random), noise(random), noise(random), 0};
  }
  const auto energy = [&](const Positions& p) {
    double sum = 0;
    for (const auto& e : rings->edges()) {
      for (const auto& [i, j] : {std::pair{e.a, e.b}, std::pair{e.b, e.a}}) {
        const Eigen::Vector3f r = t.rest_positions.row(i) - t.rest_positions.row(j), d = p.row(i) - p.row(j);
        sum += static_cast<double>(e.weight) * (d - gradients.at(i) * r).cast<double>().squaredNorm();
      }
    }
    return sum;
  };
  const CoordinateSolver solver(rings, {{7}, {}, 0.1}, "sheet");
  const Positions p = solve(solver, gradients, t.rest_positions, 0);
  EXPECT_EQ(p.row(7), t.rest_positions.row(7));
  constexpr float kStep = 1e-2f;
  for (Eigen::Index v = 0; v < p.rows(); ++v) {
    for (Eigen::Index c = 0; c < 3 && v != 7; ++c) {
      Positions up = p, down = p;
      up(v, c) += kStep;
      down(v, c) -= kStep;
      EXPECT_NEAR((energy(up) - energy(down)) / (2 * static_cast<double>(kStep)), 0, 1e-4);
    }
  }
}

// A wave of l edges keeps s = cos^2(pi / l) of its amplitude, and 1 - (1 - s)^(m + 1) after m passes.
TEST(Coordinates, AmplitudeLaw) {
  const Topology t = test::sheet(97, 25, 0.01f);
  const auto rings = test::rings_of(t);
  for (const int length : {4, 8, 16}) {
    // In the plane and along x, where the law is exact: small, so that gradients are linear in it.
    const auto wave = [&](const Eigen::Vector3f& p) {
      return Eigen::Vector3f(p.x(), 1e-4f * std::sin(2 * test::kPi * p.x() / (0.01f * static_cast<float>(length))),
                             p.z());
    };
    const Positions p = test::deform(t, wave);
    const CoordinateSolver solver(rings, {{0, 12, 24, 2400, 2412, 2424}, {}, 0.1}, "sheet");
    for (int passes = 0; passes <= 3; ++passes) {
      const Positions back = solve(solver, test::gradients_of(*rings, p), p, passes);
      double with = 0, own = 0;
      for (int i = 32; i < 64; ++i) {
        const Eigen::Index v = 25 * i + 12;
        with += static_cast<double>(back(v, 1) * p(v, 1));
        own += static_cast<double>(p(v, 1) * p(v, 1));
      }
      const double s = std::pow(std::cos(static_cast<double>(test::kPi) / length), 2);
      EXPECT_NEAR(with / own, 1 - std::pow(1 - s, passes + 1), 0.03) << length << ' ' << passes;
    }
  }
}

TEST(Coordinates, NoisyAnchorsCostLessThanTheirNoise) {
  const Subdivision fine = subdivide(test::sheet(9, 9, 0.125f), 3);
  const auto rings = test::rings_of(fine.fine);
  const Positions p = test::deform(fine.fine, test::waves);
  Positions noisy = p;
  std::mt19937 random(5);
  std::normal_distribution<float> noise(0, 0.01f / std::sqrt(3.0f));
  for (Eigen::Index k = 0; k < noisy.size(); ++k) noisy.data()[k] += noise(random);
  const CoordinateSolver solver(rings, {{}, fine.feature_vertices, 0.1}, "sheet");
  EXPECT_LT(test::rms(solve(solver, test::gradients_of(*rings, p), p, 2), p), 2e-4);
  EXPECT_LT(test::rms(solve(solver, test::gradients_of(*rings, p), noisy, 2), p), 2e-3);
}

TEST(Coordinates, HandlesAreExactAndPartsFollowTheirMean) {
  // Two sheets: one hangs from a handle, the other is placed by the mean of two anchors.
  const Topology one = test::sheet(7, 7, 0.1f);
  Topology two = one;
  two.rest_positions.resize(98, 3);
  two.rest_positions << one.rest_positions, one.rest_positions.rowwise() + Eigen::RowVector3f(0, 1, 0);
  two.faces.resize(2 * one.face_count(), 3);
  two.faces << one.faces, (one.faces.array() + 49u).matrix();
  const auto rings = test::rings_of(two);
  Positions p = test::deform(two, test::waves);
  p.bottomRows(49).rowwise() += Eigen::RowVector3f(0, 0, 2);
  const CoordinateSolver solver(rings, {{3}, {60, 70}, 0}, "sheets");
  const Positions back = solve(solver, test::gradients_of(*rings, p), p, 2);
  EXPECT_EQ(back.row(3), p.row(3));
  EXPECT_LT((back.row(60) + back.row(70) - p.row(60) - p.row(70)).norm(), 1e-6f);
  EXPECT_LT(test::rms(back, p), 6e-3);
  EXPECT_THAT(test::error_of([&] {
                CoordinateSolver(rings, {{3}, {}, 0.1}, "sheets");
              }).what(),
              ::testing::StartsWith("sheets: the part of vertex 49 has neither"));
  EXPECT_THROW(CoordinateSolver(rings, {{98}, {}, 0.1}, "sheets"), Error);
}

TEST(Coordinates, RefusesWhatIsNotFinite) {
  const Topology t = test::sheet(7, 7, 0.1f);
  const auto rings = test::rings_of(t);
  const CoordinateSolver solver(rings, {{0}, {}, 0.1}, "sheet");
  GradientField gradients = test::gradients_of(*rings, t.rest_positions);
  gradients.columns[20][1][2] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(test::error_of([&] { solve(solver, gradients, t.rest_positions, 2); }).what(),
              ::testing::HasSubstr("is not finite"));
  gradients.columns.pop_back();
  EXPECT_THROW(solve(solver, gradients, t.rest_positions, 2), Error);
}

TEST(Coordinates, AllVerticesMayBeHandles) {
  const Topology t = test::sheet(2, 2, 0.1f);
  const auto rings = test::rings_of(t);
  const Positions p = test::deform(t, test::waves);
  EXPECT_EQ(solve(CoordinateSolver(rings, {{0, 1, 2, 3}, {}, 0.1}, "sheet"), test::gradients_of(*rings, p), p, 2), p);
}

}  // namespace
}  // namespace pleat::conversion
