#include "common/mesh/smooth_upsampling.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <cmath>

#include "common/mesh/connectivity.hpp"
#include "tests/support/errors.hpp"

namespace pleat {
namespace {

/// An n x n grid of squares of 0.1 m over the x-z plane, cut in triangles.
Topology grid(int n) {
  Topology mesh;
  mesh.rest_positions.resize((n + 1) * (n + 1), 3);
  for (int i = 0; i <= n; ++i) {
    for (int k = 0; k <= n; ++k) {
      mesh.rest_positions.row(i * (n + 1) + k) << 0.1F * static_cast<float>(i), 0, 0.1F * static_cast<float>(k);
    }
  }
  mesh.faces.resize(2 * n * n, 3);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < n; ++k) {
      const auto a = static_cast<std::uint32_t>(i * (n + 1) + k), b = a + static_cast<std::uint32_t>(n) + 1;
      mesh.faces.row(2 * (i * n + k)) << a, a + 1, b;
      mesh.faces.row(2 * (i * n + k) + 1) << a + 1, b + 1, b;
    }
  }
  return mesh;
}

/// Rolled around the z axis with a radius of r.
Positions rolled(const Topology& flat, float r) {
  Positions positions = flat.rest_positions;
  for (auto row : positions.rowwise()) {
    const float angle = row(0) / r;
    row << r * std::sin(angle), r * std::cos(angle), row(2);
  }
  return positions;
}

TEST(SmoothUpsampling, FollowsTheRuleOfSmoothRestMeshes) {
  Topology coarse = grid(4);
  coarse.rest_positions = rolled(coarse, 0.3F);
  const Subdivision subdivision = subdivide(coarse, 2);
  const Positions fine = SmoothUpsampling(coarse, subdivision)(coarse.rest_positions);
  const Positions expected = subdivide(coarse, 2, SubdivisionRule::kSmooth).fine.rest_positions;
  EXPECT_LT((fine - expected).cwiseAbs().maxCoeff(), 1e-6F);
}

TEST(SmoothUpsampling, KeepsAPlane) {
  const Topology coarse = grid(3);
  const Subdivision subdivision = subdivide(coarse, 3);
  const Positions fine = SmoothUpsampling(coarse, subdivision)(coarse.rest_positions);
  EXPECT_LT((fine - subdivision.fine.rest_positions).cwiseAbs().maxCoeff(), 1e-6F);
}

TEST(SmoothUpsampling, TurnsWithTheFrame) {
  const Topology coarse = grid(4);
  const Subdivision subdivision = subdivide(coarse, 2);
  const SmoothUpsampling upsampling(coarse, subdivision);
  const Positions frame = rolled(coarse, 0.2F);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(1.2F, Eigen::Vector3f(1, 2, 3).normalized()).toRotationMatrix();
  EXPECT_LT((upsampling(frame * turn) - upsampling(frame) * turn).cwiseAbs().maxCoeff(), 1e-6F);
}

TEST(SmoothUpsampling, IsSmootherThanTheCoarseSurface) {
  const Topology coarse = grid(8);
  const Subdivision subdivision = subdivide(coarse, 2);
  const Positions frame = rolled(coarse, 0.15F);
  // Largest turn of the normals between neighbours.
  const auto turn = [&](const Positions& positions) {
    float least = 1;
    const Faces& faces = subdivision.fine.faces;
    const auto normal = [&](Eigen::Index f) {
      const Eigen::RowVector3f a = positions.row(faces(f, 1)) - positions.row(faces(f, 0)),
                               b = positions.row(faces(f, 2)) - positions.row(faces(f, 0));
      return Eigen::RowVector3f(a.cross(b).normalized());
    };
    const Connectivity mesh = build_connectivity(positions.rows(), faces);
    for (const Edge& edge : mesh.edges) {
      if (edge.f1 != kNone) least = std::min(least, normal(edge.f0).dot(normal(edge.f1)));
    }
    return std::acos(std::clamp(least, -1.0F, 1.0F));
  };
  EXPECT_LT(turn(SmoothUpsampling(coarse, subdivision)(frame)),
            0.6F * turn(upsample(subdivision, coarse.faces, frame)));
}

TEST(SmoothUpsampling, WithoutARoundTheFrameStays) {
  const Topology coarse = grid(2);
  const Positions frame = rolled(coarse, 0.2F);
  EXPECT_EQ(SmoothUpsampling(coarse, subdivide(coarse, 0))(frame), frame);
}

TEST(SmoothUpsampling, RefusesAnotherMesh) {
  const Topology coarse = grid(2);
  const SmoothUpsampling upsampling(coarse, subdivide(coarse, 1));
  const Error error = test::error_of([&] { upsampling(Positions::Zero(4, 3)); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_NE(std::string(error.what()).find("4 positions"), std::string::npos) << error.what();
}

}  // namespace
}  // namespace pleat
