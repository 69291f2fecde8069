#include "services/refinement/smoothing_solver.hpp"

#include <gtest/gtest.h>

#include <random>

#include "common/mesh/sparse_cholesky.hpp"
#include "tests/unit/services/refinement/shapes.hpp"

namespace pleat::refinement {
namespace {

constexpr double kStandStill = 1e-3;

// The same operator from its definition: u_i minus the mean of its neighbours, squared, plus standing still.
Eigen::SparseMatrix<double> direct_operator(const Faces& faces, Eigen::Index vertex_count) {
  std::vector<std::vector<std::uint32_t>> around(static_cast<std::size_t>(vertex_count));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      for (const int other : {(k + 1) % 3, (k + 2) % 3}) {
        auto& list = around[faces(f, k)];
        if (std::find(list.begin(), list.end(), faces(f, other)) == list.end()) list.push_back(faces(f, other));
      }
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t v = 0; v < around.size(); ++v) {
    entries.emplace_back(v, v, 1);
    for (const std::uint32_t n : around[v]) entries.emplace_back(v, n, -1 / static_cast<double>(around[v].size()));
  }
  Eigen::SparseMatrix<double> laplacian(vertex_count, vertex_count), identity(vertex_count, vertex_count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  identity.setIdentity();
  return Eigen::SparseMatrix<double>(laplacian.transpose() * laplacian) + kStandStill * identity;
}

class Meshes : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(All, Meshes, testing::Values("tablecloth", "skirt", "sheet"));

TEST_P(Meshes, AgreesWithASolveInDoublePrecision) {
  const Topology mesh =
      GetParam() == std::string("sheet") ? test::square_sheet(5, 1) : test::load_cloth(GetParam()).subdivision.fine;
  const auto count = static_cast<std::uint32_t>(mesh.vertex_count());
  SmoothingSolver solver(mesh.faces, count, kStandStill);
  const SparseCholesky expected(direct_operator(mesh.faces, count));
  std::mt19937 random(4);
  std::normal_distribution<float> normal;
  for (const std::uint32_t loads : {1u, 30u, count}) {
    Eigen::MatrixXd right = Eigen::MatrixXd::Zero(count, 3);
    solver.begin();
    std::vector<std::uint32_t> loaded;
    for (std::uint32_t i = 0; i < loads; ++i) {
      // A patch of neighbours, as a contact is.
      const std::uint32_t v = (count / 3 + i) % count;
      const Eigen::Vector3f load(normal(random), normal(random), normal(random));
      solver.add_load(v, load);
      right.row(v) += load.cast<double>().transpose();
      loaded.push_back(v);
    }
    const Eigen::MatrixXd u = expected.solve(right);
    const double scale = u.cwiseAbs().maxCoeff();
    solver.solve();
    for (const std::uint32_t v : loaded) {
      EXPECT_LT((solver.displacement(v).cast<double>() - u.row(v).transpose()).norm(), 1e-3 * scale) << v;
    }
    solver.spread(0);
    for (std::uint32_t v = 0; v < count; ++v) {
      EXPECT_LT((solver.displacement(v).cast<double>() - u.row(v).transpose()).norm(), 1e-3 * scale) << v;
    }
  }
}

TEST(SmoothingSolver, WhatHasFadedIsZeroAndNothingElse) {
  const test::Cloth cloth = test::load_cloth("tablecloth");
  const auto count = static_cast<std::uint32_t>(cloth.fine().vertex_count());
  SmoothingSolver full(cloth.fine().faces, count, kStandStill), faded(cloth.fine().faces, count, kStandStill);
  for (SmoothingSolver* solver : {&full, &faded}) {
    solver->begin();
    solver->add_load(300, {0, 1, 0});
    solver->solve();
  }
  const float top = full.displacement(300).y();
  full.spread(0);
  faded.spread(1e-3f * top);
  std::size_t zeros = 0;
  for (std::uint32_t v = 0; v < count; ++v) {
    EXPECT_LT((full.displacement(v) - faded.displacement(v)).cwiseAbs().maxCoeff(), 3e-3f * top);
    zeros += faded.displacement(v) == Eigen::Vector3f::Zero();
  }
  EXPECT_GT(zeros, count / 2);
  EXPECT_LT(zeros, count - 100);
}

}  // namespace
}  // namespace pleat::refinement
