#include "common/mesh/subdivision.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <cmath>
#include <filesystem>

#include "common/base/error.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/obj.hpp"

namespace pleat {
namespace {

Topology garment(const std::string& name) {
  return read_obj(std::filesystem::path("deploy/garments") / (name + ".obj"));
}

double total_area(const Positions& x, const Faces& f) {
  double area = 0;
  for (Eigen::Index i = 0; i < f.rows(); ++i) {
    const Eigen::Vector3f a = x.row(f(i, 0)), b = x.row(f(i, 1)), c = x.row(f(i, 2));
    area += 0.5 * static_cast<double>((b - a).cross(c - a).norm());
  }
  return area;
}

TEST(Subdivision, GivesThePapersCounts) {
  EXPECT_EQ(subdivide(garment("tablecloth"), 2).fine.vertex_count(), 11393);
  EXPECT_EQ(subdivide(garment("skirt"), 2).fine.vertex_count(), 19798);
  EXPECT_EQ(subdivide(garment("tablecloth"), 2).fine.face_count(), 1400 * 16);
}

TEST(Subdivision, KeepsTheSurface) {
  for (const char* name : {"tablecloth", "skirt"}) {
    const Topology coarse = garment(name);
    for (const int rounds : {0, 1, 2, 3}) {
      const Subdivision s = subdivide(coarse, rounds);
      EXPECT_NO_THROW(validate_topology(s.fine, name));
      EXPECT_NO_THROW(validate_material_coordinates(s.fine, name));
      EXPECT_NEAR(total_area(s.fine.rest_positions, s.fine.faces), total_area(coarse.rest_positions, coarse.faces),
                  1e-4);
      for (std::size_t v = 0; v < s.feature_vertices.size(); ++v) {
        EXPECT_EQ(s.fine.rest_positions.row(s.feature_vertices[v]),
                  coarse.rest_positions.row(static_cast<Eigen::Index>(v)));
      }
    }
  }
}

TEST(Subdivision, IsFoundAgain) {
  // Of a curved mesh: on a flat one the smooth rule gives the middle.
  const Topology coarse = garment("skirt");
  for (const SubdivisionRule rule : {SubdivisionRule::kMidpoint, SubdivisionRule::kSmooth, SubdivisionRule::kLoop}) {
    const SubdivisionSpec spec{1, rule};
    Topology fine = subdivide(coarse, spec).fine;
    EXPECT_EQ(find_subdivision(coarse, fine), spec);
    fine.rest_positions(5, 1) += 1e-3f;
    EXPECT_EQ(find_subdivision(coarse, fine), std::nullopt);
  }
  EXPECT_EQ(find_subdivision(coarse, subdivide(coarse, 2).fine), SubdivisionSpec{2});
  EXPECT_EQ(find_subdivision(coarse, garment("tablecloth")), std::nullopt);
  EXPECT_THROW(subdivide(coarse, SubdivisionSpec{kMaxSubdivisionRounds + 1}), Error);
}

TEST(Subdivision, SmoothVerticesStayAboveTheMiddle) {
  for (const char* name : {"tablecloth", "skirt"}) {
    const Topology coarse = garment(name);
    const Topology middle = subdivide(coarse, 2).fine, smooth = subdivide(coarse, 2, SubdivisionRule::kSmooth).fine;
    EXPECT_EQ(smooth.faces, middle.faces);
    const Positions normals = vertex_normals(middle.rest_positions, middle.faces);
    const Positions moves = smooth.rest_positions - middle.rest_positions;
    for (Eigen::Index v = 0; v < moves.rows(); ++v) {
      const Eigen::RowVector3f across = moves.row(v) - moves.row(v).dot(normals.row(v)) * normals.row(v);
      EXPECT_LT(across.norm(), 1e-6f);
    }
    // A flat sheet stays one.
    EXPECT_EQ(moves.norm() < 1e-5f, std::string(name) == "tablecloth");
  }
}

TEST(Subdivision, UpsamplingReproducesTheRestShape) {
  const Topology coarse = garment("skirt");
  const Subdivision s = subdivide(coarse, 2);
  for (Eigen::Index v = 0; v < s.barycentric.rows(); ++v) {
    EXPECT_NEAR(s.barycentric.row(v).sum(), 1, 1e-6);
    EXPECT_GE(s.barycentric.row(v).minCoeff(), 0);
  }
  const Positions fine = upsample(s, coarse.faces, coarse.rest_positions);
  EXPECT_LT((fine - s.fine.rest_positions).rowwise().norm().maxCoeff(), 1e-6f);
  EXPECT_THROW(upsample(s, coarse.faces, fine), Error);
}

TEST(Subdivision, ChildrenOfAFaceAreConsecutive) {
  const Topology coarse = garment("tablecloth");
  const Subdivision s = subdivide(coarse, 2);
  // Every fine face lies in the coarse face of its number: its corners have weights on that face's corners only.
  const Positions upsampled = upsample(s, coarse.faces, coarse.rest_positions);
  for (Eigen::Index f = 0; f < s.fine.face_count(); f += 97) {
    const Eigen::RowVector3f center =
        (upsampled.row(s.fine.faces(f, 0)) + upsampled.row(s.fine.faces(f, 1)) + upsampled.row(s.fine.faces(f, 2))) / 3;
    const auto corners = coarse.faces.row(f / 16);
    const Eigen::RowVector3f parent = (coarse.rest_positions.row(corners(0)) + coarse.rest_positions.row(corners(1)) +
                                       coarse.rest_positions.row(corners(2))) /
                                      3;
    EXPECT_LT((center - parent).norm(), 0.05f);
  }
}

TEST(Subdivision, LoopChangesNothingButTheRestPositions) {
  for (const char* name : {"tablecloth", "skirt"}) {
    const Topology coarse = garment(name);
    const Subdivision middle = subdivide(coarse, 2), loop = subdivide(coarse, 2, SubdivisionRule::kLoop);
    EXPECT_EQ(loop.fine.faces, middle.fine.faces);
    EXPECT_EQ(loop.fine.uv, middle.fine.uv);
    EXPECT_EQ(loop.fine.uv_faces, middle.fine.uv_faces);
    EXPECT_EQ(loop.barycentric, middle.barycentric);
    EXPECT_NO_THROW(validate_topology(loop.fine, name));
    EXPECT_NE(topology_hash(loop.fine), topology_hash(middle.fine));
  }
}

TEST(Subdivision, LoopsMasks) {
  // A tetrahedron: every vertex has three neighbours, for which Loop's weight is 3/16.
  Topology t;
  t.rest_positions.resize(4, 3);
  t.rest_positions << 0, 0, 0, 16, 0, 0, 0, 16, 0, 0, 0, 16;
  t.faces.resize(4, 3);
  t.faces << 0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3;
  const Positions fine = subdivide(t, 1, SubdivisionRule::kLoop).fine.rest_positions;
  ASSERT_EQ(fine.rows(), 10);
  EXPECT_LT((fine.row(0) - Eigen::RowVector3f(3, 3, 3)).norm(), 1e-5f);
  EXPECT_LT((fine.row(1) - Eigen::RowVector3f(7, 3, 3)).norm(), 1e-5f);
  // The edge 0-2 is the first: 3/8 of its ends, 1/8 of the other two.
  EXPECT_LT((fine.row(4) - Eigen::RowVector3f(2, 6, 2)).norm(), 1e-5f);
}

TEST(Subdivision, LoopSmoothsTheBoundaryAsACurveAndKeepsCorners) {
  // A hexagonal plate whose centre is lifted: the boundary must not notice. It turns by 60 degrees: all corners. A
  // plate with twelve corners turns by 30: none.
  const auto plate = [](int corners) {
    Topology t;
    t.rest_positions.resize(corners + 1, 3);
    t.faces.resize(corners, 3);
    for (int i = 0; i < corners; ++i) {
      const float angle = 6.2831853f * static_cast<float>(i) / static_cast<float>(corners);
      t.rest_positions.row(i) << std::cos(angle), 0, std::sin(angle);
      t.faces.row(i) << static_cast<std::uint32_t>(corners), static_cast<std::uint32_t>((i + 1) % corners),
          static_cast<std::uint32_t>(i);
    }
    t.rest_positions.row(corners) << 0, 3, 0;
    return t;
  };
  const Topology hexagon = plate(6);
  const Positions fine = subdivide(hexagon, 1, SubdivisionRule::kLoop).fine.rest_positions;
  EXPECT_EQ(fine.topRows(6), hexagon.rest_positions.topRows(6));
  EXPECT_FLOAT_EQ(fine(6, 1), 3 * 0.625f);  // six neighbours: 1/16 each, here at height 0
  const Topology round = plate(12);
  const Positions smooth = subdivide(round, 1, SubdivisionRule::kLoop).fine.rest_positions;
  for (int i = 0; i < 12; ++i) {
    const Eigen::RowVector3f expected = 0.75f * round.rest_positions.row(i) +
                                        0.125f * round.rest_positions.row((i + 1) % 12) +
                                        0.125f * round.rest_positions.row((i + 11) % 12);
    EXPECT_LT((smooth.row(i) - expected).norm(), 1e-6f);
  }
}

TEST(Subdivision, LoopKeepsARegularFlatSheet) {
  // Six equal neighbours everywhere inside, a straight boundary: every rule is the midpoint's.
  Topology t;
  const int n = 4;
  t.rest_positions.resize((n + 1) * (n + 1), 3);
  for (int j = 0; j <= n; ++j) {
    for (int i = 0; i <= n; ++i) {
      t.rest_positions.row(j * (n + 1) + i) << static_cast<float>(i), 0, static_cast<float>(j);
    }
  }
  t.faces.resize(2 * n * n, 3);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const auto a = static_cast<std::uint32_t>(j * (n + 1) + i), below = a + static_cast<std::uint32_t>(n) + 1;
      t.faces.row(2 * (j * n + i)) << a, below, a + 1;
      t.faces.row(2 * (j * n + i) + 1) << a + 1, below, below + 1;
    }
  }
  for (const int rounds : {1, 2}) {
    const Positions loop = subdivide(t, rounds, SubdivisionRule::kLoop).fine.rest_positions;
    EXPECT_LT((loop - subdivide(t, rounds).fine.rest_positions).cwiseAbs().maxCoeff(), 1e-5f);
  }
}

TEST(Subdivision, RefusesSillyDepths) {
  EXPECT_THROW(subdivide(garment("tablecloth"), -1), Error);
  EXPECT_THROW(subdivide(garment("tablecloth"), 6), Error);
}

}  // namespace
}  // namespace pleat
