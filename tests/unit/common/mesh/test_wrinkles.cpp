#include "common/mesh/wrinkles.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/base/error.hpp"

namespace pleat {
namespace {

constexpr int kSide = 33;

/// A square of kSide x kSide vertices with one metre between them, whose height is a function of column and row.
template <typename Height>
Positions sheet(const Height& height) {
  Positions positions(kSide * kSide, 3);
  for (int j = 0; j < kSide; ++j)
    for (int i = 0; i < kSide; ++i)
      positions.row(j * kSide + i) << static_cast<float>(i), static_cast<float>(height(i, j)), static_cast<float>(j);
  return positions;
}

Faces sheet_faces() {
  Faces faces(2 * (kSide - 1) * (kSide - 1), 3);
  Eigen::Index f = 0;
  for (std::uint32_t j = 0; j + 1 < kSide; ++j) {
    for (std::uint32_t i = 0; i + 1 < kSide; ++i) {
      const std::uint32_t a = j * kSide + i;
      faces.row(f++) << a, a + kSide, a + 1;
      faces.row(f++) << a + 1, a + kSide, a + kSide + 1;
    }
  }
  return faces;
}

/// Every fourth vertex in both directions.
std::vector<std::uint32_t> lattice_vertices() {
  std::vector<std::uint32_t> vertices;
  for (std::uint32_t j = 0; j < kSide; j += 4)
    for (std::uint32_t i = 0; i < kSide; i += 4) vertices.push_back(j * kSide + i);
  return vertices;
}

WrinkleMeter meter() { return {kSide * kSide, sheet_faces(), lattice_vertices()}; }

TEST(WrinkleMeter, FlatClothHasNoEnergyAndNoLattice) {
  const WrinkleFigures figures = meter().measure(sheet([](int, int) { return 0.0; }));
  for (const double band : figures.bands) EXPECT_NEAR(band, 0, 1e-10);
  EXPECT_DOUBLE_EQ(figures.lattice, 1);
}

/// The definition by plain loops over the faces, for one band after the other.
TEST(WrinkleMeter, AgreesWithTheDefinition) {
  const Positions positions = sheet([](int i, int j) { return 0.4 * std::sin(0.9 * i) + 0.2 * std::cos(1.7 * j); });
  const Faces faces = sheet_faces();
  Eigen::MatrixXd ring = Eigen::MatrixXd::Identity(positions.rows(), positions.rows());
  for (Eigen::Index f = 0; f < faces.rows(); ++f)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) ring(faces(f, i), faces(f, j)) = 1;
  for (Eigen::Index v = 0; v < ring.rows(); ++v) ring.row(v) /= ring.row(v).sum();
  Eigen::MatrixXd smooth = vertex_normals(positions, faces).cast<double>();
  const WrinkleFigures figures = meter().measure(positions);
  for (std::size_t band = 0; band < 3; ++band) {
    const Eigen::MatrixXd before = smooth;
    for (int k = kBandRounds[band]; k < kBandRounds[band + 1]; ++k) smooth = ring * smooth;
    const double expected = (before - smooth).squaredNorm() / static_cast<double>(positions.rows());
    EXPECT_NEAR(figures.bands[band], expected, 1e-4 * expected + 1e-9) << "band " << band;
  }
}

TEST(WrinkleMeter, LongerWavesAreInLaterBands) {
  const auto strongest = [](double wavelength) {
    const auto bands =
        meter().measure(sheet([&](int i, int) { return 0.1 * wavelength * std::sin(6.283 * i / wavelength); })).bands;
    return std::max_element(bands.begin(), bands.end()) - bands.begin();
  };
  EXPECT_EQ(strongest(3), 0);
  EXPECT_EQ(strongest(6), 1);
  EXPECT_EQ(strongest(14), 2);
}

TEST(WrinkleMeter, LatticeSeesBumpsAtCoarseVertices) {
  const auto bump = [](int i, int j) { return i % 4 == 0 && j % 4 == 0 ? 0.2 : 0.0; };
  const auto away = [](int i, int j) { return i % 4 == 2 && j % 4 == 2 ? 0.2 : 0.0; };
  const auto wave = [](int i, int j) { return 0.3 * std::sin(0.83 * i + 0.41 * j); };
  const double plain = meter().measure(sheet(wave)).lattice;
  EXPECT_NEAR(plain, 1, 0.1);
  EXPECT_GT(std::abs(meter().measure(sheet(bump)).lattice - 1), 0.2);
  EXPECT_GT(std::abs(meter().measure(sheet(bump)).lattice - meter().measure(sheet(away)).lattice), 0.2);
}

TEST(WrinkleMeter, RefusesOtherSizes) {
  EXPECT_THROW(meter().measure(Positions::Zero(3, 3)), Error);
  const std::vector<std::uint32_t> outside{kSide * kSide};
  EXPECT_THROW(WrinkleMeter(kSide * kSide, sheet_faces(), outside), Error);
}

}  // namespace
}  // namespace pleat
