#include "services/simulation/strain_limits.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <random>

#include "services/simulation/simulation.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::Vector3d;

std::vector<Vector3d> shaken(const Topology& mesh, double scale, double noise) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-noise, noise);
  std::vector<Vector3d> x;
  for (Eigen::Index v = 0; v < mesh.vertex_count(); ++v) {
    x.emplace_back(scale * mesh.rest_positions.row(v).cast<double>().transpose() +
                   Vector3d(uniform(random), uniform(random), uniform(random)));
  }
  return x;
}

Eigen::Matrix3d corners_of(const Topology& mesh, Eigen::Index f, const std::vector<Vector3d>& x) {
  Eigen::Matrix3d corners;
  for (int k = 0; k < 3; ++k) corners.col(k) = x[mesh.faces(f, k)];
  return corners;
}

// The smallest and the largest principal stretch of a mesh.
std::pair<double, double> stretches(const Topology& mesh, const std::vector<Vector3d>& x) {
  std::pair<double, double> range{1e9, 0};
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const auto s = principal_stretches(shape_gradients(mesh, f), corners_of(mesh, f, x)).stretch;
    range = {std::min(range.first, s[1]), std::max(range.second, s[0])};
  }
  return range;
}

TEST(StrainLimits, StretchesAreSingularValues) {
  const Topology mesh = sheet(3, 2, 0.3, 0.5);
  const auto x = shaken(mesh, 1.1, 0.05);
  for (Eigen::Index f = 0; f < mesh.face_count(); ++f) {
    const ShapeGradients gradients = shape_gradients(mesh, f);
    // Its definition: the deformation gradient maps edges in material coordinates to edges in space.
    const Eigen::Matrix<double, 3, 2> deformation = corners_of(mesh, f, x) * gradients.transpose();
    for (int k = 1; k < 3; ++k) {
      const Eigen::Vector2d du =
          mesh.uv.row(mesh.uv_faces(f, k)).cast<double>() - mesh.uv.row(mesh.uv_faces(f, 0)).cast<double>();
      EXPECT_LT((deformation * du - (x[mesh.faces(f, k)] - x[mesh.faces(f, 0)])).norm(), 1e-9);
    }
    const Eigen::JacobiSVD<Eigen::Matrix<double, 3, 2>> svd(deformation, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const PrincipalStretches s = principal_stretches(gradients, corners_of(mesh, f, x));
    for (int k = 0; k < 2; ++k) {
      EXPECT_NEAR(s.stretch[static_cast<std::size_t>(k)], svd.singularValues()[k], 1e-9);
      EXPECT_NEAR(std::abs(s.directions.col(k).dot(svd.matrixV().col(k))), 1, 1e-9);
    }
  }
}

TEST(StrainLimits, ProjectsIntoTheRangeAndKeepsMomentum) {
  const Topology mesh = sheet(5, 4, 0.5, 0.4);
  for (const double scale : {1.15, 0.85}) {
    auto x = shaken(mesh, scale, 0.01);
    const auto before = x;
    std::vector<double> inverse_masses(x.size());
    for (std::size_t v = 0; v < x.size(); ++v) inverse_masses[v] = 100 + 10 * static_cast<double>(v % 5);
    EXPECT_TRUE(StrainLimits(mesh, {0.95, 1.05}).project(x, inverse_masses));
    const auto [least, most] = stretches(mesh, x);
    EXPECT_GT(least, 0.948);
    EXPECT_LT(most, 1.052);
    Vector3d momentum = Vector3d::Zero();
    for (std::size_t v = 0; v < x.size(); ++v) momentum += (x[v] - before[v]) / inverse_masses[v];
    EXPECT_LT(momentum.norm(), 1e-12);
  }
}

TEST(StrainLimits, OneFaceIsNotTurned) {
  Topology mesh = sheet(1, 1, 0.1, 0.1);
  mesh.faces = Faces(mesh.faces.topRows(1));
  mesh.uv_faces = mesh.faces;
  auto x = shaken(mesh, 1.3, 0.02);
  const auto before = x;
  const std::vector<double> inverse_masses{1, 2, 3, 4};
  EXPECT_TRUE(StrainLimits(mesh, {0.999999, 1.25}).project(x, inverse_masses));
  // Every step is along the gradient of a function that turning does not change: no torque about where it was. Several
  // steps add up to almost none.
  Vector3d turn = Vector3d::Zero();
  double moved = 0;
  for (int k = 0; k < 3; ++k) {
    const std::uint32_t v = mesh.faces(0, k);
    turn += before[v].cross(x[v] - before[v]) / inverse_masses[v];
    moved += before[v].norm() * (x[v] - before[v]).norm() / inverse_masses[v];
  }
  EXPECT_GT(moved, 1e-4);
  EXPECT_LT(turn.norm(), 1e-3 * moved);
}

TEST(StrainLimits, LeaveWhatIsInRangeOrPrescribed) {
  const Topology mesh = sheet(4, 4, 0.4, 0.4);
  auto x = shaken(mesh, 1.02, 0.0);
  const auto before = x;
  const std::vector<double> free(x.size(), 1), held(x.size(), 0);
  EXPECT_FALSE(StrainLimits(mesh, {0.95, 1.05}).project(x, free));
  EXPECT_FALSE(StrainLimits(mesh, {}).project(x, free));
  EXPECT_FALSE(StrainLimits(mesh, {1, 1.01}).project(x, held));
  EXPECT_EQ(x, before);
}

TEST(StrainLimits, ASoftClothHangsNoLongerThanItsLimit) {
  // The largest stretches of the coarse and of the fine mesh.
  const auto most = [](const StretchRange& range) {
    Scene scene = sheet_scene(6);
    scene.material = plain_material(6, 2e-5);
    scene.transform.rotation = {1.5707963267948966, 0, 0};
    scene.damping_s = 0.01;
    scene.strain_limits = range;
    Handle handle;
    for (std::uint32_t i = 0; i <= 6; ++i) handle.vertices.push_back(i);
    handle.hard = true;
    scene.handles.push_back(handle);
    Simulation simulation(scene, Mode::kFreeFine);
    SimulatedFrame frame;
    for (int k = 0; k < 12; ++k) frame = simulation.next_frame();
    const auto largest = [](const Topology& mesh, const Positions& positions) {
      std::vector<Vector3d> x;
      for (Eigen::Index v = 0; v < positions.rows(); ++v) x.emplace_back(positions.row(v).cast<double>().transpose());
      return stretches(mesh, x).second;
    };
    return std::pair(largest(simulation.coarse(), frame.coarse.positions),
                     largest(simulation.fine(), frame.fine->positions));
  };
  const auto [coarse_free, fine_free] = most({});
  EXPECT_GT(coarse_free, 1.1);
  EXPECT_GT(fine_free, 1.1);
  const auto [coarse, fine] = most({0, 1.03});
  EXPECT_LT(coarse, 1.032);
  EXPECT_LT(fine, 1.045);  // forty sweeps a step carry the load over 24 rows of faces almost
}

}  // namespace
}  // namespace pleat::simulation
