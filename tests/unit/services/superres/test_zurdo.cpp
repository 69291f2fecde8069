// Wrinkles by example on a sheet whose compression decides its wrinkles.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "common/base/error.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/superres/zurdo.hpp"

namespace pleat::superres {
namespace {

MeshPair sheet() {
  constexpr int kCells = 6;
  Topology coarse;
  const int n = kCells + 1;
  coarse.rest_positions.resize(n * n, 3);
  coarse.uv.resize(n * n, 2);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const float x = static_cast<float>(i) / kCells, z = static_cast<float>(j) / kCells;
      coarse.rest_positions.row(j * n + i) << x, 0, -z;
      coarse.uv.row(j * n + i) << x, z;
    }
  }
  coarse.faces.resize(2 * kCells * kCells, 3);
  Eigen::Index f = 0;
  for (std::uint32_t j = 0; j < kCells; ++j) {
    for (std::uint32_t i = 0; i < kCells; ++i) {
      const std::uint32_t a = j * n + i;
      coarse.faces.row(f++) << a, a + 1, a + n + 1;
      coarse.faces.row(f++) << a, a + n + 1, a + n;
    }
  }
  coarse.uv_faces = coarse.faces;
  Subdivision subdivision = subdivide(coarse, 2);
  return {coarse, subdivision.fine, subdivision.feature_vertices};
}

/// The sheet squeezed along x; what it loses in length stands up in waves.
ZurdoPose squeezed(const MeshPair& mesh, float ratio) {
  ZurdoPose pose{mesh.coarse.rest_positions, mesh.fine.rest_positions};
  pose.coarse.col(0) *= ratio;
  pose.fine.col(0) *= ratio;
  for (Eigen::Index v = 0; v < pose.fine.rows(); ++v) {
    pose.fine(v, 1) += 0.1F * (1 - ratio) * std::sin(40 * mesh.fine.rest_positions(v, 0));
  }
  return pose;
}

double rms(const Positions& a, const Positions& b) {
  return std::sqrt((a - b).cast<double>().squaredNorm() / static_cast<double>(a.rows()));
}

class Zurdo : public testing::Test {
 protected:
  ZurdoWrinkles learn(const ZurdoOptions& options) const {
    return {mesh_, ratios_.size(), [this](std::size_t k) { return squeezed(mesh_, ratios_[k]); }, options};
  }
  const MeshPair mesh_ = sheet();
  const std::vector<float> ratios_{1.0F, 0.98F, 0.96F, 0.94F, 0.92F, 0.9F};
};

TEST_F(Zurdo, ExamplesComeBackExactly) {
  const ZurdoWrinkles wrinkles = learn({6, 3, 0});
  EXPECT_EQ(wrinkles.examples().size(), ratios_.size());
  for (const float ratio : ratios_) {
    const ZurdoPose pose = squeezed(mesh_, ratio);
    EXPECT_LT(rms(wrinkles.synthesize(pose.coarse), pose.fine), 1e-5) << ratio;
  }
}

TEST_F(Zurdo, BetweenExamplesItInterpolates) {
  const ZurdoWrinkles wrinkles = learn({6, 3, 0});
  const ZurdoPose pose = squeezed(mesh_, 0.95F);
  const Subdivision subdivision = subdivide(mesh_.coarse, 2);
  const double plain = rms(upsample(subdivision, mesh_.coarse.faces, pose.coarse), pose.fine);
  // |d| is linear between two poses on a line, and so are these wrinkles.
  EXPECT_LT(rms(wrinkles.synthesize(pose.coarse), pose.fine), 0.02 * plain);
}

TEST_F(Zurdo, WrinklesTurnWithTheCloth) {
  const ZurdoWrinkles wrinkles = learn({6, 3, 0});
  const ZurdoPose pose = squeezed(mesh_, 0.93F);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(0.8F, Eigen::Vector3f(1, 2, 3).normalized()).toRotationMatrix();
  const auto moved = [&turn](const Positions& p) -> Positions {
    return (p * turn.transpose()).rowwise() + Eigen::RowVector3f(0.3F, -1, 2);
  };
  EXPECT_LT(rms(wrinkles.synthesize(moved(pose.coarse)), moved(wrinkles.synthesize(pose.coarse))), 1e-5);
}

TEST_F(Zurdo, TheFarthestPosesAreChosen) {
  EXPECT_EQ(learn({2, 3, 0}).examples(), (std::vector<std::size_t>{0, 5}));
  EXPECT_EQ(learn({3, 3, 0}).examples().size(), 3u);
  const std::vector<std::size_t> first_alone{0};
  EXPECT_EQ(ZurdoWrinkles(mesh_, 4, [this](std::size_t) { return squeezed(mesh_, 0.9F); }).examples(), first_alone);
}

TEST_F(Zurdo, BadInputIsRefused) {
  EXPECT_THROW(learn({0, 3, 0}), Error);
  EXPECT_THROW(learn({6, 0, 0}), Error);
  EXPECT_THROW(ZurdoWrinkles(mesh_, 0, [this](std::size_t) { return squeezed(mesh_, 1); }), Error);
  EXPECT_THROW(learn({6, 3, 0}).synthesize(Positions::Zero(3, 3)), Error);
  MeshPair other = mesh_;
  other.fine = mesh_.coarse;
  other.fine.rest_positions.conservativeResize(60, 3);
  EXPECT_THROW(ZurdoWrinkles(other, 1, [this](std::size_t) { return squeezed(mesh_, 1); }), Error);
}

}  // namespace
}  // namespace pleat::superres
