#include "services/simulation/averages.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numeric>
#include <random>

#include "common/base/parallel.hpp"
#include "services/simulation/dynamics.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::simulation {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;

// A sheet with uneven masses, subdivided; the solver's order is the vertices' reversed.
class AveragesOfASheet : public testing::Test {
 protected:
  AveragesOfASheet() : coarse(sheet(3, 2, 0.6, 0.5)), subdivision(subdivide(coarse, 2)) {
    const auto n = static_cast<std::size_t>(subdivision.fine.vertex_count());
    std::mt19937 engine(5);
    std::uniform_real_distribution<double> mass(1e-5, 5e-5);
    for (std::uint32_t v = 0; v < n; ++v) {
      masses.push_back(mass(engine));
      place.push_back(static_cast<std::uint32_t>(n) - 1 - v);
    }
    averages = Averages(subdivision, coarse.faces, masses, place);
  }

  // The weights as the definition has them: (V_coarse x V_fine), by vertex, and the masses of the hats.
  MatrixXd phi(Eigen::VectorXd& hat_masses) const {
    MatrixXd weights = MatrixXd::Zero(coarse.vertex_count(), subdivision.fine.vertex_count());
    for (Eigen::Index i = 0; i < weights.cols(); ++i) {
      const auto vertex = static_cast<std::size_t>(i);
      for (int k = 0; k < 3; ++k) {
        weights(coarse.faces(subdivision.parent_face[vertex], k), i) +=
            masses[vertex] * static_cast<double>(subdivision.barycentric(i, k));
      }
    }
    hat_masses = weights.rowwise().sum();
    return hat_masses.cwiseInverse().asDiagonal() * weights;
  }

  std::vector<Float4> by_place(const MatrixXd& field) const {
    std::vector<Float4> values(place.size());
    for (std::size_t v = 0; v < place.size(); ++v) {
      values[place[v]] = to_float4(field.row(static_cast<Eigen::Index>(v)).transpose());
    }
    return values;
  }

  // H / omega^2 times the field.
  MatrixXd pull(const MatrixXd& field) {
    averages.gather(by_place(field), pool);
    MatrixXd result(field.rows(), 3);
    for (std::size_t v = 0; v < place.size(); ++v) {
      const Float4 row = averages.pull_at(place[v]);
      for (int k = 0; k < 3; ++k) result(static_cast<Eigen::Index>(v), k) = static_cast<double>(row[k]);
    }
    return result;
  }

  MatrixXd random_field(unsigned seed) const {
    std::mt19937 engine(seed);
    std::normal_distribution<double> noise(0, 0.01);
    return MatrixXd::NullaryExpr(subdivision.fine.vertex_count(), 3, [&] { return noise(engine); });
  }

  Topology coarse;
  Subdivision subdivision;
  std::vector<double> masses;
  std::vector<std::uint32_t> place;
  Averages averages;
  ThreadPool pool{2};
};

TEST_F(AveragesOfASheet, OperatorIsTheDenseOne) {
  Eigen::VectorXd hat_masses;
  const MatrixXd weights = phi(hat_masses), hessian = weights.transpose() * hat_masses.asDiagonal() * weights;
  const MatrixXd field = random_field(1), expected = hessian * field;
  EXPECT_LT((pull(field) - expected).norm(), 1e-6 * expected.norm());
  for (std::size_t v = 0; v < place.size(); ++v) {
    const auto i = static_cast<Eigen::Index>(v);
    EXPECT_NEAR(static_cast<double>(averages.diagonal(place[v])), hessian(i, i), 1e-6 * hessian(i, i));
  }
}

TEST_F(AveragesOfASheet, ForceIsMinusTheGradientOfTheEnergy) {
  Eigen::VectorXd hat_masses;
  const MatrixXd weights = phi(hat_masses), target = random_field(2);
  MatrixXd x = random_field(3);
  const auto energy = [&] { return 0.5 * hat_masses.dot((weights * (x - target)).rowwise().squaredNorm()); };
  const MatrixXd force = pull(target - x);
  for (const Eigen::Index i : {0, 7, 30, 61}) {
    for (int k = 0; k < 3; ++k) {
      const double at = x(i, k), step = 1e-4;
      x(i, k) = at + step;
      const double above = energy();
      x(i, k) = at - step;
      const double below = energy();
      x(i, k) = at;
      EXPECT_NEAR(force(i, k), (below - above) / (2 * step), 1e-5 * force.norm());
    }
  }
}

TEST_F(AveragesOfASheet, WhatHasNoAveragesFeelsNoForce) {
  Eigen::VectorXd hat_masses;
  const MatrixXd weights = phi(hat_masses);
  MatrixXd field = random_field(4);
  field -= weights.transpose() * (weights * weights.transpose()).ldlt().solve(weights * field);
  ASSERT_GT(field.norm(), 0.01);
  EXPECT_LT(pull(field).norm(), 1e-6 * pull(random_field(4)).norm());
}

TEST_F(AveragesOfASheet, ACommonOffsetPullsEveryVertexByItsMass) {
  const MatrixXd offset = Vector3d(1, -2, 3).transpose().replicate(subdivision.fine.vertex_count(), 1);
  const MatrixXd force = pull(offset);
  for (std::size_t v = 0; v < masses.size(); ++v) {
    const auto i = static_cast<Eigen::Index>(v);
    EXPECT_LT((force.row(i) - masses[v] * offset.row(i)).norm(), 1e-5 * masses[v]);
  }
  EXPECT_NEAR(averages.total_mass(), std::accumulate(masses.begin(), masses.end(), 0.0), 1e-12);
}

TEST_F(AveragesOfASheet, DoublesKeepSmallDifferencesOfLargeFields) {
  const MatrixXd difference = 1e-4 * random_field(6);
  MatrixXd large = difference;
  large.rowwise() += Eigen::RowVector3d(100, 0, 0);
  std::vector<Double4> field(place.size());
  for (std::size_t v = 0; v < place.size(); ++v) {
    const auto i = static_cast<Eigen::Index>(v);
    field[place[v]] = Double4{large(i, 0) - 100, large(i, 1), large(i, 2), 0};
  }
  averages.gather(field, pool);
  const Float4 row = averages.pull_at(place[10]);
  EXPECT_NEAR(static_cast<double>(row[1]), pull(difference)(10, 1),
              1e-6 * std::abs(static_cast<double>(row[1])) + 1e-15);
}

// With hardly any stiffness of the cloth's own a step is (M + h^2 omega^2 H) dv = h (g M + omega^2 H (y - x - h v)).
class AveragesInAStep : public testing::Test {
 protected:
  AveragesInAStep() : scene(sheet_scene(4)), subdivision(subdivide(scene.garment, 2)) {
    scene.material = plain_material(1e-9, 0);
    step.length_s = 0.04;
    step.damping_s = 0;
    step.gravity = {0, -9.81, 0};
    step.wind.density = 0;
    step.tolerance = 1e-6;
    std::mt19937 engine(8);
    std::uniform_real_distribution<double> noise(-0.02, 0.02);
    const auto random = [&] { return Vector3d(noise(engine), noise(engine), noise(engine)); };
    for (Eigen::Index i = 0; i < subdivision.fine.vertex_count(); ++i) {
      positions.emplace_back(subdivision.fine.rest_positions.row(i).cast<double>().transpose());
      velocities.push_back(10 * random());
      targets.push_back(positions.back() + random());
    }
    step.targets = targets;
  }

  Scene scene;
  Subdivision subdivision;
  Points positions, velocities, targets;
  Dynamics::Step step;
  ThreadPool pool{1};
};

TEST_F(AveragesInAStep, AStepSolvesTheDenseSystem) {
  Dynamics dynamics(subdivision.fine, scene);
  dynamics.use_levels(subdivision);
  dynamics.track_averages(subdivision, scene.garment.faces);
  step.frequency = 30;
  const auto n = static_cast<Eigen::Index>(positions.size());
  Eigen::VectorXd mass(n);
  MatrixXd weights = MatrixXd::Zero(scene.garment.vertex_count(), n), offset(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto v = static_cast<std::size_t>(i);
    mass(i) = dynamics.masses()[v];
    for (int k = 0; k < 3; ++k) {
      weights(scene.garment.faces(subdivision.parent_face[v], k), i) +=
          mass(i) * static_cast<double>(subdivision.barycentric(i, k));
    }
    offset.row(i) = (targets[v] - positions[v] - step.length_s * velocities[v]).transpose();
  }
  const Eigen::VectorXd hat_masses = weights.rowwise().sum();
  const MatrixXd hessian = weights.transpose() * hat_masses.cwiseInverse().asDiagonal() * weights;
  const double h = step.length_s, stiffness = step.frequency * step.frequency;
  MatrixXd system = h * h * stiffness * hessian;
  system.diagonal() += mass;
  const MatrixXd right = h * (mass * step.gravity.transpose() + stiffness * hessian * offset);
  const MatrixXd expected = system.ldlt().solve(right);
  Points after = velocities;
  dynamics.solve(positions, after, step, pool);
  double error = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto v = static_cast<std::size_t>(i);
    error = std::max(error, (after[v] - velocities[v] - expected.row(i).transpose()).norm());
  }
  EXPECT_LT(error, 2e-4 * expected.rowwise().norm().maxCoeff());
}

TEST_F(AveragesInAStep, MomentumChangesByGravityAndThePullAlone) {
  scene.material = plain_material(60, 2e-5);
  Dynamics dynamics(subdivision.fine, scene);
  dynamics.use_levels(subdivision);
  dynamics.track_averages(subdivision, scene.garment.faces);
  step.frequency = 20;
  step.tolerance = 3e-2;  // what the iterations leave over must not matter
  Points after = velocities;
  dynamics.solve(positions, after, step, pool);
  // A common pull: h omega^2 sum_i m_i (y - x - h v_after).
  Vector3d change = Vector3d::Zero(), expected = Vector3d::Zero();
  const double h = step.length_s;
  for (std::size_t v = 0; v < after.size(); ++v) {
    const double mass = dynamics.masses()[v];
    change += mass * (after[v] - velocities[v]);
    expected += h * mass * (step.gravity + 400 * (targets[v] - positions[v] - h * after[v]));
  }
  EXPECT_LT((change - expected).norm(), 1e-4 * expected.norm());
}

TEST_F(AveragesInAStep, StiffAveragesCostFewIterationsMore) {
  scene.material = plain_material(60, 2e-5);
  Dynamics dynamics(subdivision.fine, scene);
  dynamics.use_levels(subdivision);
  dynamics.track_averages(subdivision, scene.garment.faces);
  step.tolerance = 3e-3;
  const auto iterations = [&](double frequency) {
    step.frequency = frequency;
    dynamics.forget_last_change();
    Points after = velocities;
    return dynamics.solve(positions, after, step, pool);
  };
  const int free = iterations(0);
  EXPECT_LT(iterations(9), free + 5);
  EXPECT_LT(iterations(250), 3 * free);
}

}  // namespace
}  // namespace pleat::simulation
