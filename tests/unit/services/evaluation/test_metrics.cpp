// Every metric on a case worked by hand; docs/metrics.md has the definitions.
#include "services/evaluation/metrics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "common/base/error.hpp"
#include "common/base/statistics.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/evaluation/surface_distance.hpp"

namespace pleat::evaluation {
namespace {

Topology grid(int cells, float size) {
  Topology t;
  const int n = cells + 1;
  t.rest_positions.resize(n * n, 3);
  t.uv.resize(n * n, 2);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const float x = size * static_cast<float>(i) / static_cast<float>(cells);
      const float z = size * static_cast<float>(j) / static_cast<float>(cells);
      t.rest_positions.row(j * n + i) << x, 0, z;
      t.uv.row(j * n + i) << x, z;
    }
  }
  t.faces.resize(2 * cells * cells, 3);
  Eigen::Index f = 0;
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      const auto a = static_cast<std::uint32_t>(j * n + i), b = a + 1, c = a + static_cast<std::uint32_t>(n), d = c + 1;
      t.faces.row(f++) << a, b, d;
      t.faces.row(f++) << a, d, c;
    }
  }
  t.uv_faces = t.faces;
  return t;
}

Positions triangle(float c_y) {
  Positions p(3, 3);
  p << 0, 0, 0, 3, 0, 0, 0, c_y, 0;
  return p;
}

Faces one_face() {
  Faces f(1, 3);
  f << 0, 1, 2;
  return f;
}

TEST(VertexMeanSquareError, IsTheMeanOfSquaredDistances) {
  Positions a(2, 3), b(2, 3);
  a.setZero();
  b << 0.1f, 0, 0, 0, 0.2f, 0;
  EXPECT_NEAR(vertex_mean_square_error(a, b), (0.01 + 0.04) / 2, 1e-8);
}

TEST(VertexMeanSquareError, RefusesDifferentSizes) {
  EXPECT_THROW(vertex_mean_square_error(Positions(2, 3), Positions(3, 3)), Error);
}

TEST(SurfaceDistance, EqualsBruteForce) {
  const Topology mesh = grid(6, 1);
  std::mt19937 random(7);
  std::normal_distribution<float> noise(0, 0.05f);
  Positions bent = mesh.rest_positions;
  for (Eigen::Index i = 0; i < bent.size(); ++i) bent.data()[i] += noise(random);
  const SurfaceDistance surface(mesh.faces, bent);
  std::uniform_real_distribution<double> place(-0.5, 1.5);
  for (int k = 0; k < 200; ++k) {
    const Eigen::Vector3d p(place(random), place(random), place(random));
    double expected = std::numeric_limits<double>::infinity();
    for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
      const auto corner = [&](int i) -> Eigen::Vector3d {
        return bent.row(mesh.faces(f, i)).transpose().cast<double>();
      };
      expected = std::min(expected, closest_vertex_face(p, corner(0), corner(1), corner(2)).squared_distance);
    }
    EXPECT_NEAR(surface.squared_distance(p, std::numeric_limits<double>::infinity()), expected, 1e-12);
    EXPECT_DOUBLE_EQ(surface.squared_distance(p, expected / 2), expected / 2);
  }
}

TEST(Hausdorff, OfParallelSheetsIsTheirDistance) {
  const Topology mesh = grid(3, 1);
  Positions raised = mesh.rest_positions;
  raised.col(1).array() += 0.25f;
  EXPECT_NEAR(hausdorff_distance(mesh.faces, mesh.rest_positions, raised), 0.25, 1e-7);
}

TEST(Hausdorff, IgnoresSlidingInsideTheSurface) {
  const Topology mesh = grid(2, 2);
  Positions slid = mesh.rest_positions;
  slid(4, 0) += 0.3f;  // the middle vertex, inside the plane
  EXPECT_NEAR(hausdorff_distance(mesh.faces, mesh.rest_positions, slid), 0, 1e-7);
  EXPECT_GT(vertex_mean_square_error(mesh.rest_positions, slid), 0.005);
}

TEST(Hausdorff, IsTheLargestOfBothDirections) {
  const Topology mesh = grid(2, 2);
  Positions spike = mesh.rest_positions;
  spike(4, 1) += 0.5f;
  // The spike's tip is 0.5 from the sheet; the sheet's middle is nearer to the spike's slopes.
  EXPECT_NEAR(hausdorff_distance(mesh.faces, mesh.rest_positions, spike), 0.5, 1e-7);
  EXPECT_NEAR(hausdorff_distance(mesh.faces, spike, mesh.rest_positions), 0.5, 1e-7);
}

TEST(Sted, SpatialPartOfOneTriangle) {
  // Edges 3, 4, 5 become 3, 8, sqrt(73): relative differences 0, 1, r. Two values x, y with weights p, q have the
  // deviation sqrt(p q) / (p + q) |x - y|.
  StedAccumulator sted(3, one_face());
  sted.begin_sequence();
  sted.add(triangle(4), triangle(8));
  const double r = (std::sqrt(73.0) - 5) / 5;
  const double expected = (std::sqrt(12.0) / 7 * 1 + std::sqrt(15.0) / 8 * r + std::sqrt(20.0) / 9 * (1 - r)) / 3;
  EXPECT_NEAR(sted.values().spatial, expected, 1e-6);
  EXPECT_EQ(sted.values().temporal, 0);
  EXPECT_NEAR(sted.values().combined, expected, 1e-6);
}

TEST(Sted, IsZeroUnderUniformScaling) {
  const Topology mesh = grid(4, 1);
  StedAccumulator sted(mesh.vertex_count(), mesh.faces);
  sted.add(mesh.rest_positions, mesh.rest_positions * 1.5f);
  EXPECT_NEAR(sted.values().combined, 0, 1e-6);
}

TEST(Sted, TemporalPartOfOneJump) {
  // The reference rests: every temporal edge is as long as the step, 0.002. Vertex 0 of the candidate jumps once by
  // sqrt(3) steps, which doubles its edge: relative differences 1 and 0 with equal weights, deviation 1/2.
  const Positions rest = triangle(4);
  Positions jumped = rest;
  jumped(0, 2) = static_cast<float>(5 * 0.002 * std::sqrt(3.0));  // the bounding box diagonal is 5
  StedAccumulator sted(3, one_face());
  sted.begin_sequence();
  sted.add(rest, rest);
  sted.add(rest, jumped);
  sted.add(rest, jumped);
  const StedValues values = sted.values();
  EXPECT_NEAR(values.temporal, 0.5 / 3, 1e-5);
  EXPECT_NEAR(values.combined, std::hypot(values.spatial, 0.13 * values.temporal), 1e-12);
}

TEST(Sted, SequencesAreNotJoined) {
  const Positions rest = triangle(4);
  Positions elsewhere = rest;
  elsewhere.col(2).array() += 1;
  StedAccumulator sted(3, one_face());
  for (const Positions& candidate : {rest, elsewhere}) {
    sted.begin_sequence();
    for (int k = 0; k < 3; ++k) sted.add(rest, candidate);
  }
  EXPECT_NEAR(sted.values().temporal, 0, 1e-9);
}

TEST(Jitter, IsTheErrorOfSecondDifferences) {
  Positions still(1, 3), moved(1, 3);
  still.setZero();
  moved << 0.003f, 0, 0;
  JitterAccumulator jitter;
  jitter.begin_sequence();
  jitter.add(still, still);
  jitter.add(still, moved);
  EXPECT_EQ(jitter.value(), 0);
  jitter.add(still, still);
  EXPECT_NEAR(jitter.value(), 0.006, 1e-8);  // 0 - 2 e + 0
}

TEST(Jitter, IgnoresAConstantOffset) {
  Positions still(2, 3), offset(2, 3);
  still.setZero();
  offset.setConstant(0.5f);
  JitterAccumulator jitter;
  for (int k = 0; k < 4; ++k) jitter.add(still, offset);
  EXPECT_EQ(jitter.value(), 0);
}

TEST(Jitter, RatioComparesSecondDifferences) {
  // The reference swings by 1 mm a frame, the candidate by 3 mm in the other direction.
  JitterAccumulator jitter;
  jitter.begin_sequence();
  for (int k = 0; k < 5; ++k) {
    Positions reference(1, 3), candidate(1, 3);
    reference << (k % 2 == 0 ? 0.0f : 0.001f), 0, 0;
    candidate << (k % 2 == 0 ? 0.0f : -0.003f), 0, 0;
    jitter.add(reference, candidate);
  }
  EXPECT_NEAR(jitter.ratio(), 3, 1e-5);
  EXPECT_NEAR(jitter.value(), 0.008, 1e-7);  // 2 (1 mm + 3 mm)
  EXPECT_EQ(JitterAccumulator().ratio(), 1);
}

/// Long stripes along z, whose height is a function of the column.
template <typename Height>
Positions stripes(const Topology& sheet, int cells, const Height& height) {
  Positions positions = sheet.rest_positions;
  for (Eigen::Index v = 0; v < positions.rows(); ++v)
    positions(v, 1) = static_cast<float>(height(static_cast<double>(v % (cells + 1))));
  return positions;
}

TEST(WrinkleAccumulator, ComparesAmountsNotPlaces) {
  constexpr int kCells = 32;
  const Topology sheet = grid(kCells, 32);
  const auto wave = [&](double phase, double amplitude) {
    return stripes(sheet, kCells, [=](double i) { return amplitude * std::sin(0.9 * i + phase); });
  };
  WrinkleAccumulator same(sheet.vertex_count(), sheet.faces, {}), flatter = same, none = same;
  EXPECT_DOUBLE_EQ(same.ratios()[0], 1);
  same.add(wave(0, 0.2), wave(1.3, 0.2));
  flatter.add(wave(0, 0.2), wave(0, 0.1));
  none.add(wave(0, 0.2), sheet.rest_positions);
  for (const std::size_t band : {0U, 1U}) {
    EXPECT_NEAR(same.ratios()[band], 1, 0.15);
    EXPECT_NEAR(flatter.ratios()[band], 0.25, 0.05);
    EXPECT_NEAR(none.ratios()[band], 0, 1e-6);
  }
}

TEST(WrinkleAccumulator, IsInfiniteWhereOnlyTheReferenceIsFlat) {
  const Topology sheet = grid(4, 1);
  WrinkleAccumulator wrinkles(sheet.vertex_count(), sheet.faces, {});
  wrinkles.add(sheet.rest_positions, stripes(sheet, 4, [](double i) { return 0.1 * std::sin(2 * i); }));
  EXPECT_TRUE(std::isinf(wrinkles.ratios()[0]));
}

TEST(NormalAngle, OfATurnedTriangleIsTheTurn) {
  // Lifting the third vertex from (0, 4, 0) to (0, 0, 4) turns the normal from z to -y.
  Positions turned = triangle(4);
  turned.row(2) << 0, 0, 4;
  EXPECT_NEAR(mean_normal_angle(one_face(), triangle(4), turned), 90, 1e-5);
  turned.row(2) << 0, 4, 4;
  EXPECT_NEAR(mean_normal_angle(one_face(), triangle(4), turned), 45, 1e-5);
  EXPECT_NEAR(mean_normal_angle(one_face(), triangle(4), triangle(8)), 0, 1e-6);
}

TEST(NormalAngle, IsTheMeanOverVertices) {
  // Two faces in a plane; one folds up by a right angle. The outer vertices see 0 and 90 degrees, the two on the fold
  // the mean of both normals, 45 degrees.
  Positions flat(4, 3), folded(4, 3);
  flat << 0, 0, 0, 0, 0, 1, 1, 0, 0.5f, -1, 0, 0.5f;
  folded = flat;
  folded.row(3) << 0, 1, 0.5f;
  Faces faces(2, 3);
  faces << 0, 1, 2, 1, 0, 3;
  EXPECT_NEAR(mean_normal_angle(faces, flat, folded), (45 + 45 + 0 + 90) / 4.0, 1e-4);
}

TEST(Stretch, IsTheErrorOfEdgeLengthsOverRestLengths) {
  // Rest 3, 4, 5. In the reference the edge of 4 has become 8 and that of 5 sqrt(73), in the candidate nothing changed.
  const StretchError stretch(one_face(), triangle(4));
  const double longest = (std::sqrt(73.0) - 5) / 5;
  EXPECT_NEAR(stretch(triangle(8), triangle(4)), std::sqrt((0 + 1 + longest * longest) / 3), 1e-6);
  EXPECT_NEAR(stretch(triangle(8), triangle(8)), 0, 1e-9);
}

TEST(DisplacementImageError, OfAConstantOffset) {
  const Topology coarse = grid(4, 1);
  const Topology fine = subdivide(coarse, 2).fine;
  const ChannelRanges range{{-0.5f, -1, -2, 0, 0, 0, 0, 0, 0}, {1, 2, 4, 1, 1, 1, 1, 1, 1}};
  DisplacementImageError error(coarse, fine, range);
  Positions candidate = fine.rest_positions;
  candidate.col(0).array() += 0.1f;  // a tenth of the first channel's range, nothing in the others
  const double mse = error.mean_square_error(coarse.rest_positions, fine.rest_positions, candidate);
  EXPECT_NEAR(mse, 0.01 / 3, 1e-6);
  EXPECT_NEAR(psnr_db(mse), 10 * std::log10(300), 1e-3);
}

TEST(DisplacementImageError, MovesWithTheGarment) {
  const Topology coarse = grid(4, 1);
  const Topology fine = subdivide(coarse, 2).fine;
  const ChannelRanges range{{-0.5f, -1, -2, 0, 0, 0, 0, 0, 0}, {1, 2, 4, 1, 1, 1, 1, 1, 1}};
  DisplacementImageError error(coarse, fine, range);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(1.2f, Eigen::Vector3f(1, 2, 3).normalized()).toRotationMatrix();
  const auto moved = [&turn](const Positions& p) -> Positions {
    return (p * turn.transpose()).rowwise() + Eigen::RowVector3f(1, -2, 0.5f);
  };
  Positions candidate = fine.rest_positions;
  candidate.col(0).array() += 0.1f;
  EXPECT_NEAR(error.mean_square_error(moved(coarse.rest_positions), moved(fine.rest_positions), moved(candidate)),
              0.01 / 3, 1e-5);
}

TEST(DisplacementImageError, RefusesAnEmptyRange) {
  const Topology coarse = grid(4, 1);
  const Topology fine = subdivide(coarse, 2).fine;
  EXPECT_THROW(DisplacementImageError(coarse, fine, ChannelRanges{}), Error);
}

TEST(MetricsAccumulator, PoolsFramesAndSums) {
  const Topology coarse = grid(4, 1);
  const Topology fine = subdivide(coarse, 1).fine;
  MetricsAccumulator metrics(coarse, fine, {}, ChannelRanges{std::vector<float>(9, 0), std::vector<float>(9, 1)});
  Positions candidate = fine.rest_positions;
  candidate.col(1).array() += 0.2f;
  metrics.begin_sequence();
  metrics.add(coarse.rest_positions, fine.rest_positions, fine.rest_positions, {5, 0, 2, 2});
  metrics.add(coarse.rest_positions, fine.rest_positions, candidate, {4, 3, 7, 4});
  const MetricValues values = metrics.values();
  EXPECT_EQ(values.frames, 2u);
  EXPECT_NEAR(values.vmse_m2, 0.04 / 2, 1e-8);
  EXPECT_NEAR(values.rmse_m, std::sqrt(0.02), 1e-7);
  EXPECT_NEAR(values.hausdorff_m, 0.1, 1e-7);
  ASSERT_TRUE(values.psnr_db.has_value());
  EXPECT_NEAR(*values.psnr_db, 10 * std::log10(1 / (0.04 / 3 / 2)), 1e-3);
  EXPECT_NEAR(values.rmse_relative, std::sqrt(0.02 / 2), 1e-7);  // the sheet's diagonal is sqrt(2)
  EXPECT_NEAR(values.normal_angle_deg, 0, 1e-6);
  EXPECT_NEAR(values.stretch, 0, 1e-7);
  EXPECT_EQ(values.counts.penetrations_before, 9u);
  EXPECT_EQ(values.counts.penetrations, 3u);
  EXPECT_EQ(values.counts.self_intersections_before, 9u);
  EXPECT_EQ(values.counts.self_intersections, 6u);
}

TEST(MetricsAccumulator, HasNoPsnrWithoutARange) {
  const Topology coarse = grid(4, 1);
  const Topology fine = subdivide(coarse, 1).fine;
  MetricsAccumulator metrics(coarse, fine, {}, std::nullopt);
  Positions candidate = fine.rest_positions;
  candidate.col(1).array() += 0.2f;
  metrics.add(coarse.rest_positions, fine.rest_positions, candidate);
  EXPECT_FALSE(metrics.values().psnr_db.has_value());
}

}  // namespace
}  // namespace pleat::evaluation
