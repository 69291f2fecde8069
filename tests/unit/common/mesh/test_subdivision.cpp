#include "common/mesh/subdivision.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

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

TEST(Subdivision, RefusesSillyDepths) {
  EXPECT_THROW(subdivide(garment("tablecloth"), -1), Error);
  EXPECT_THROW(subdivide(garment("tablecloth"), 6), Error);
}

}  // namespace
}  // namespace pleat
