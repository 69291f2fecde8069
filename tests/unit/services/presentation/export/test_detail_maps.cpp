#include "services/presentation/export/detail_maps.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <cmath>

#include "common/mesh/subdivision.hpp"
#include "tests/support/errors.hpp"

namespace pleat::presentation {
namespace {

/// A flat sheet of 1 m x 0.5 m, u along x, v along -z, and a fine one with waves along x.
class Sheet : public testing::Test {
 protected:
  Sheet() {
    constexpr int kColumns = 8, kRows = 4;
    Topology coarse;
    coarse.rest_positions.resize((kColumns + 1) * (kRows + 1), 3);
    coarse.uv.resize(coarse.rest_positions.rows(), 2);
    for (int i = 0; i <= kColumns; ++i) {
      for (int k = 0; k <= kRows; ++k) {
        const float u = static_cast<float>(i) / kColumns, v = 0.5F * static_cast<float>(k) / kRows;
        coarse.rest_positions.row(i * (kRows + 1) + k) << u, 0, -v;
        coarse.uv.row(i * (kRows + 1) + k) << 3 + u, 5 + v;
      }
    }
    coarse.faces.resize(2 * kColumns * kRows, 3);
    for (int i = 0; i < kColumns; ++i) {
      for (int k = 0; k < kRows; ++k) {
        const auto a = static_cast<std::uint32_t>(i * (kRows + 1) + k), b = a + kRows + 1;
        coarse.faces.row(2 * (i * kRows + k)) << a, b, a + 1;
        coarse.faces.row(2 * (i * kRows + k) + 1) << a + 1, b, b + 1;
      }
    }
    coarse.uv_faces = coarse.faces;
    coarse_ = coarse.rest_positions;
    const Subdivision subdivision = subdivide(coarse, 3);
    fine_ = subdivision.fine.rest_positions;
    for (auto row : fine_.rowwise()) row(1) = height(row(0));
    auto held = std::make_shared<ExportInput>();
    held->topology = coarse;
    input_.topology = subdivision.fine;
    input_.coarse = held;
  }

  static float height(float x) { return 0.02F * std::sin(10 * x); }
  static float slope(float x) { return 0.2F * std::cos(10 * x); }

  /// The x of a texel's centre, by the texture coordinates of the mesh: two of its vertices say where x is.
  float x_of(const DetailMaps& maps, int column) const {
    const Topology& mesh = maps.mesh();
    const float left = mesh.uv.col(0).minCoeff(), right = mesh.uv.col(0).maxCoeff();
    return ((static_cast<float>(column) + 0.5F) / kSize - left) / (right - left);
  }

  static constexpr int kSize = 128;
  ExportInput input_;
  Positions coarse_, fine_;
};

TEST_F(Sheet, DisplacementIsFromTheCoarseSurfaceToTheFineOne) {
  const DetailMaps maps(input_, kSize);
  EXPECT_GE(maps.mesh().uv.minCoeff(), 0);
  EXPECT_LE(maps.mesh().uv.maxCoeff(), 1);
  const DetailMaps::Images images = maps.at(coarse_, fine_);
  int seen = 0;
  for (int column = 0; column < kSize; ++column) {
    const float x = x_of(maps, column);
    if (x < 0 || x > 1) continue;
    ++seen;
    // Rows: v is up, and the sheet fills the lower half.
    const std::size_t texel = 3 * static_cast<std::size_t>((kSize - 30) * kSize + column);
    EXPECT_NEAR(images.displacement[texel], 0, 1e-6F);
    EXPECT_NEAR(images.displacement[texel + 1], height(x), 1e-4F) << x;
    EXPECT_NEAR(images.displacement[texel + 2], 0, 1e-6F);
  }
  EXPECT_GT(seen, 100);
}

TEST_F(Sheet, NormalsAreInTheCoarseMeshsFrameWhereverTheClothIs) {
  const DetailMaps maps(input_, kSize);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(0.7F, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  const DetailMaps::Images images = maps.at(coarse_ * turn, fine_ * turn), upright = maps.at(coarse_, fine_);
  const auto value = [](std::uint16_t code) { return 2 * static_cast<float>(code) / 65535 - 1; };
  for (int column = 0; column < kSize; ++column) {
    const float x = x_of(maps, column);
    if (x < 0.1F || x > 0.9F) continue;
    const std::size_t texel = 3 * static_cast<std::size_t>((kSize - 30) * kSize + column);
    const float length = std::sqrt(1 + slope(x) * slope(x));
    EXPECT_NEAR(value(images.normal[texel]), -slope(x) / length, 0.01F) << x;
    EXPECT_NEAR(value(images.normal[texel + 1]), 0, 0.01F);
    EXPECT_NEAR(value(images.normal[texel + 2]), 1 / length, 0.01F);
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(images.normal[texel + k], upright.normal[texel + k], 4);
  }
}

TEST_F(Sheet, BesideTheClothTheNearestTexelGoesOn) {
  const DetailMaps maps(input_, kSize);
  const DetailMaps::Images images = maps.at(coarse_, fine_);
  int first = 0;
  while (x_of(maps, first) < 0) ++first;
  const std::size_t row = static_cast<std::size_t>((kSize - 30) * kSize);
  ASSERT_GT(first, 1);
  const auto displacement = [&](int column) {
    return images.displacement[3 * (row + static_cast<std::size_t>(column)) + 1];
  };
  EXPECT_EQ(displacement(first - 1), displacement(first));
  EXPECT_EQ(displacement(first - 2), displacement(first));
  // Far from the cloth there is nothing.
  EXPECT_EQ(images.displacement[3 * (10 * kSize + 64) + 1], 0);
  EXPECT_EQ(images.normal[3 * (10 * kSize + 64) + 2], 65535);
}

TEST_F(Sheet, WithoutDetailTheMapsAreFlat) {
  const DetailMaps maps(input_, kSize);
  const DetailMaps::Images images = maps.at(coarse_, input_.topology.rest_positions);
  for (std::size_t i = 0; i < images.displacement.size(); ++i) {
    ASSERT_NEAR(images.displacement[i], 0, 1e-6F);
    ASSERT_NEAR(images.normal[i], i % 3 == 2 ? 65535 : 32768, 1);
  }
}

TEST_F(Sheet, RefusesWhatNoMapIsFor) {
  EXPECT_EQ(test::error_of([&] { DetailMaps(input_, 8); }).code(), ErrorCode::kInvalidArgument);
  input_.topology.uv.resize(0, 2);
  EXPECT_EQ(test::error_of([&] { DetailMaps(input_, kSize); }).code(), ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace pleat::presentation
