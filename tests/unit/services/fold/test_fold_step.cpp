#include "services/fold/fold_step.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "common/base/error.hpp"
#include "services/simulation/averages.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

using Eigen::RowVector3f;

class FoldStepTest : public testing::Test {
 protected:
  FoldStepTest() : coarse(simulation::sheet(6, 6, 0.5, 0.5)), subdivision(subdivide(coarse, 2)) {
    options.material = simulation::plain_material(60, 2e-5);
    options.threads = 1;
    rest = coarse.rest_positions;
    still = Positions::Zero(coarse.vertex_count(), 3);
  }

  FoldStep make(const std::vector<ObstacleShape>& obstacles = {}) const {
    return FoldStep(coarse, subdivision, obstacles, options);
  }

  Positions upsampled(const Positions& positions) const { return upsample(subdivision, coarse.faces, positions); }

  // A sheet that is squeezed to 0.8 of its width within some frames and rests then. Returns the last state.
  FoldState squeeze(FoldStep& step, int frames, FoldState state = {}) const {
    Positions before = rest;
    for (int k = 1; k <= frames; ++k) {
      Positions now = rest;
      now.col(0) *= 1 - 0.2f * static_cast<float>(std::min(k, 5)) / 5;
      for (Eigen::Index v = 0; v < now.rows(); ++v) now(v, 1) += 1e-3f * std::sin(40 * now(v, 0) + 3 * now(v, 2));
      const Positions velocities = (now - before) / 0.04f;
      step.fold({now, velocities}, state);
      before = now;
    }
    return state;
  }

  Topology coarse;
  Subdivision subdivision;
  FoldOptions options;
  Positions rest, still;
};

TEST_F(FoldStepTest, FallsWithAFallingCloth) {
  options.gravity = {0, -10, 0};
  options.frequency = 0;         // inertia alone
  options.material.density = 3;  // hardly slowed by the air
  FoldStep step = make();
  FoldState state;
  Positions now = rest, velocities = still;
  for (int k = 0; k < 10; ++k) {
    velocities.col(1).setConstant(-0.2f - 0.4f * static_cast<float>(k));
    now += 0.04f * velocities;
    step.fold({now, velocities}, state);
  }
  EXPECT_LT(now.col(1).mean(), -0.7f);
  EXPECT_NEAR(state.positions.col(1).mean(), now.col(1).mean(), 0.02f);
  EXPECT_LT(state.positions.col(1).maxCoeff() - state.positions.col(1).minCoeff(), 1e-3f);
}

TEST_F(FoldStepTest, FoldsASqueezedSheetInsteadOfCompressingIt) {
  options.gravity.setZero();
  FoldStep step = make();
  const FoldState state = squeeze(step, 15);
  ASSERT_TRUE(state.positions.allFinite());
  const float height = state.positions.col(1).maxCoeff() - state.positions.col(1).minCoeff();
  EXPECT_GT(height, 0.02f);  // the coarse cloth's is 0.002
  // The length along the sheet is more than the coarse one's.
  double length = 0, flat = 0;
  Positions now = rest;
  now.col(0) *= 0.8f;
  const Positions base = upsampled(now);
  const auto connectivity_length = [&](const Positions& p) {
    double sum = 0;
    for (Eigen::Index f = 0; f < subdivision.fine.face_count(); ++f) {
      sum += static_cast<double>((p.row(subdivision.fine.faces(f, 1)) - p.row(subdivision.fine.faces(f, 0))).norm());
    }
    return sum;
  };
  length = connectivity_length(state.positions);
  flat = connectivity_length(base);
  EXPECT_GT(length, 1.02 * flat);
}

TEST_F(FoldStepTest, ResultsDependOnTheArgumentsAloneForAnyNumberOfThreads) {
  FoldStep one = make();
  const FoldState first = squeeze(one, 6);
  options.threads = 3;
  FoldStep three = make();
  squeeze(three, 3);  // what another session has done before must not matter
  const FoldState again = squeeze(three, 6);
  EXPECT_EQ(first.positions, again.positions);
  EXPECT_EQ(first.velocities, again.velocities);
}

TEST_F(FoldStepTest, StateThatDoesNotFitIsNotContinued) {
  FoldStep step = make();
  FoldState state;
  EXPECT_TRUE(step.fold({rest, still}, state).restarted);
  EXPECT_FALSE(step.fold({rest, still}, state).restarted);
  Positions far = rest;
  far.col(0).array() += 5;
  EXPECT_TRUE(step.fold({far, still}, state).restarted);
  EXPECT_LT((state.positions - upsampled(far)).rowwise().norm().maxCoeff(), 0.05f);
}

TEST_F(FoldStepTest, QuickMotionTakesSeveralSteps) {
  FoldStep step = make();
  FoldState state;
  EXPECT_EQ(step.fold({rest, still}, state).steps, 1);
  Positions moved = rest, velocities = still;
  moved.col(0).array() += 0.1f;
  velocities.col(0).setConstant(2.5f);
  const FoldReport report = step.fold({moved, velocities}, state);
  EXPECT_FALSE(report.restarted);
  EXPECT_EQ(report.steps, options.most_steps);
}

TEST_F(FoldStepTest, StaysOutOfObstacles) {
  FoldStep step = make({{"ball", {}, 0}});
  ObstacleFrame ball;
  ball.name = "ball";
  ball.center = {0, -0.1f, 0};
  ball.radius = 0.099f;
  const std::vector<ObstacleFrame> obstacles{ball};
  FoldState state;
  for (int k = 0; k < 10; ++k) step.fold({rest, still, obstacles}, state);
  float nearest = 1;
  for (Eigen::Index v = 0; v < state.positions.rows(); ++v) {
    nearest = std::min(nearest, (state.positions.row(v) - ball.center.transpose()).norm() - ball.radius);
  }
  EXPECT_GT(nearest, 0);
}

TEST_F(FoldStepTest, WhatIsHeldStays) {
  FoldStep step = make();
  const std::vector<std::uint32_t> held{0, 6};
  FoldState state;
  for (int k = 0; k < 10; ++k) step.fold({rest, still, {}, held}, state);
  for (const std::uint32_t h : held) EXPECT_LT((state.positions.row(h) - rest.row(h)).norm(), 1e-3f);
}

TEST_F(FoldStepTest, AStartMovesTheSolutionNotTheProblem) {
  options.tolerance = 1e-4;
  options.most_iterations = 400;
  FoldStep step = make();
  const FoldState before = squeeze(step, 6);
  FoldState plain = before, started = before;
  Positions now = rest;
  now.col(0) *= 0.8f;
  step.fold({now, still}, plain);
  const Positions start = plain.positions;
  step.fold({now, still, {}, {}, &start}, started);
  // Another step of Newton from the answer.
  EXPECT_LT((plain.positions - started.positions).rowwise().norm().maxCoeff(), 0.02f);
}

TEST_F(FoldStepTest, RefusesBadInputAndKeepsTheState) {
  FoldStep step = make();
  FoldState state;
  step.fold({rest, still}, state);
  const FoldState good = state;
  Positions bad = rest;
  bad(3, 1) = NAN;
  const std::vector<std::uint32_t> held{999};
  EXPECT_THROW(step.fold({bad, still}, state), Error);
  EXPECT_THROW(step.fold({Positions(rest.topRows(3)), still}, state), Error);
  EXPECT_THROW(step.fold({rest, still, {}, held}, state), Error);
  EXPECT_EQ(state.positions, good.positions);
  FoldState small;
  small.positions = small.velocities = rest;
  EXPECT_THROW(step.fold({rest, still}, small), Error);
  for (const auto& spoil : std::initializer_list<std::function<void(FoldOptions&)>>{
           [](FoldOptions& o) { o.frequency = -1; }, [](FoldOptions& o) { o.frequency = 1e4; },
           [](FoldOptions& o) { o.frame_time_s = 0; }, [](FoldOptions& o) { o.most_steps = 0; },
           [](FoldOptions& o) { o.tolerance = 1; }, [](FoldOptions& o) { o.material.density = 0; }}) {
    FoldOptions spoilt = options;
    spoil(spoilt);
    EXPECT_THROW(FoldStep(coarse, subdivision, {}, spoilt), Error);
  }
}

}  // namespace
}  // namespace pleat::fold
