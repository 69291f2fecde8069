#include "services/fold/fold_step.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>

#include "common/base/error.hpp"
#include "services/refinement/judge.hpp"
#include "tests/unit/services/simulation/garments.hpp"

namespace pleat::fold {
namespace {

using Eigen::RowVector3f;

class FoldStepTest : public testing::Test {
 protected:
  FoldStepTest() : coarse(simulation::sheet(6, 6, 0.5, 0.5)), subdivision(subdivide(coarse, 2)) {
    options.material = simulation::plain_material(60, 2e-5);
    rest = coarse.rest_positions;
    still = Positions::Zero(coarse.vertex_count(), 3);
  }

  FoldStep make(const std::vector<ObstacleShape>& obstacles = {}) const {
    return FoldStep(coarse, subdivision, obstacles, options);
  }

  Positions upsampled(const Positions& positions) const { return upsample(subdivision, coarse.faces, positions); }

  // A sheet that is squeezed to 0.8 of its width within some frames and rests then. Returns the last state.
  FoldState squeeze(FoldStep& step, int frames, FoldState state = {}, float unevenness = 1e-3f) const {
    Positions before = rest;
    for (int k = 1; k <= frames; ++k) {
      Positions now = rest;
      now.col(0) *= 1 - 0.2f * static_cast<float>(std::min(k, 5)) / 5;
      for (Eigen::Index v = 0; v < now.rows(); ++v) now(v, 1) += unevenness * std::sin(40 * now(v, 0) + 3 * now(v, 2));
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

TEST_F(FoldStepTest, FoldsASheetThatIsExactlyFlat) {
  options.gravity.setZero();
  FoldStep step = make();
  const FoldState state = squeeze(step, 15, {}, 0);
  EXPECT_GT(state.positions.col(1).maxCoeff() - state.positions.col(1).minCoeff(), 0.02f);
}

TEST_F(FoldStepTest, ResultsDependOnTheArgumentsAlone) {
  FoldStep one = make();
  const FoldState first = squeeze(one, 6);
  FoldStep another = make();
  squeeze(another, 3);  // what a session has done before must not matter
  const std::vector<std::uint32_t> held{0, 6};
  FoldState other;
  another.fold({rest, still, {}, held}, other);
  const FoldState again = squeeze(another, 6);
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

TEST_F(FoldStepTest, FramesOfAnyLengthAreMadeOfStepsThatAreShortEnough) {
  for (const double frame_time_s : {0.001, 1.0 / 60, 0.04, 0.1, 1.5}) {
    options.frame_time_s = frame_time_s;
    FoldStep step = make();
    FoldState state;
    const FoldReport report = step.fold({rest, still}, state);
    EXPECT_LE(frame_time_s / report.steps, options.step_s * (1 + 1e-6));
    EXPECT_GT(frame_time_s / std::max(1, report.steps - 1), options.step_s * (1 - 1e-6) * (report.steps > 1 ? 1 : 0));
  }
}

// Two sheets above each other that the coarse cloth keeps apart and the state has the wrong way round.
TEST_F(FoldStepTest, LayersThatHavePassedThroughEachOtherAreSorted) {
  const Eigen::Index n = coarse.vertex_count();
  Topology two = coarse;
  two.rest_positions.conservativeResize(2 * n, 3);
  two.rest_positions.bottomRows(n) = rest.rowwise() + RowVector3f(0, 0.008f, 0);
  two.faces.conservativeResize(2 * coarse.face_count(), 3);
  two.faces.bottomRows(coarse.face_count()) = coarse.faces.array() + static_cast<std::uint32_t>(n);
  const Eigen::Index u = coarse.uv.rows();
  two.uv.conservativeResize(2 * u, 2);
  two.uv.bottomRows(u) = coarse.uv.array() + 10;
  two.uv_faces.conservativeResize(2 * coarse.face_count(), 3);
  two.uv_faces.bottomRows(coarse.face_count()) = coarse.uv_faces.array() + static_cast<std::uint32_t>(u);
  const Subdivision fine = subdivide(two, 2);
  options.gravity.setZero();
  FoldStep step(two, fine, {}, options);
  const Positions quiet = Positions::Zero(2 * n, 3);
  FoldState state;
  state.positions = upsample(fine, two.faces, two.rest_positions);
  state.velocities = Positions::Zero(state.positions.rows(), 3);
  const Eigen::Index v = fine.fine.vertex_count();
  std::vector<Eigen::Index> upper, lower;
  for (Eigen::Index i = 0; i < v; ++i) (state.positions(i, 1) > 0.004f ? upper : lower).push_back(i);
  const auto height = [&](const std::vector<Eigen::Index>& layer) {
    float sum = 0;
    for (const Eigen::Index i : layer) sum += state.positions(i, 1);
    return sum / static_cast<float>(layer.size());
  };
  for (const Eigen::Index i : upper) state.positions(i, 1) -= 0.006f;
  for (const Eigen::Index i : lower) state.positions(i, 1) += 0.006f;
  ASSERT_LT(height(upper), height(lower));
  EXPECT_GT(step.fold({two.rest_positions, quiet}, state).layer_contacts, 0u);
  for (int k = 0; k < 5; ++k) step.fold({two.rest_positions, quiet}, state);
  EXPECT_GT(height(upper), height(lower) + 0.002f);
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

// A cloth that lies on a steep obstacle by friction, as a skirt on hips: the fine one does not slide down.
TEST_F(FoldStepTest, StaysWhereTheCoarseClothTouches) {
  const auto sag = [&](float distance, float slope) {
    FoldStep step = make();
    Positions wall = rest;  // along y, beside a large ball; from above further and further away from it
    wall.col(1) = rest.col(2);
    wall.col(2) = slope * (0.25f - rest.col(2).array());
    ObstacleFrame ball;
    ball.name = "ball";
    ball.radius = 100;
    ball.center = {0, 0, -100 - distance};
    const std::vector<ObstacleFrame> obstacles{ball};
    FoldState state;
    for (int k = 0; k < 40; ++k) step.fold({wall, still, obstacles}, state);
    return (upsampled(wall) - state.positions).col(1).mean();
  };
  EXPECT_LT(sag(0.004f, 0), 0.005f);
  EXPECT_LT(sag(0.004f, 0.05f), 0.012f);  // the upper half bears the lower one
  EXPECT_GT(sag(0.05f, 0), 0.03f);
}

TEST_F(FoldStepTest, WhatIsHeldStays) {
  FoldStep step = make();
  const std::vector<std::uint32_t> held{0, 6};
  FoldState state;
  for (int k = 0; k < 10; ++k) step.fold({rest, still, {}, held}, state);
  for (const std::uint32_t h : held) EXPECT_LT((state.positions.row(h) - rest.row(h)).norm(), 1e-3f);
}

TEST_F(FoldStepTest, AClothThatIsHeldEverywhereIsTheUpsampledOne) {
  FoldStep step = make({{"ball", {}, 0}});
  ObstacleFrame ball;
  ball.name = "ball";
  ball.center = {0, -0.1f, 0};
  ball.radius = 0.11f;  // reaches through the cloth, which cannot give way
  const std::vector<ObstacleFrame> obstacles{ball};
  std::vector<std::uint32_t> held(static_cast<std::size_t>(coarse.vertex_count()));
  std::iota(held.begin(), held.end(), 0u);
  FoldState state;
  for (int k = 0; k < 3; ++k) {
    step.fold({rest, still, obstacles, held}, state);
    EXPECT_LT((state.positions - upsampled(rest)).rowwise().norm().maxCoeff(), 1e-6f);
  }
}

// A pleat that has been pulled through the cloth beside it.
TEST_F(FoldStepTest, WhatPassesThroughItselfGoesBack) {
  options.gravity.setZero();
  FoldStep step = make();
  FoldState state;
  step.fold({rest, still}, state);
  for (Eigen::Index v = 0; v < state.positions.rows(); ++v) {
    const float along = state.positions(v, 0), height = 0.04f * std::exp(-along * along / 8e-4f);
    state.positions(v, 0) += 3 * height * std::tanh(-along / 0.01f);
    state.positions(v, 1) += height;
  }
  ASSERT_GT(refinement::count_self_intersections(state.positions, subdivision.fine.faces), 0u);
  for (int k = 0; k < 20; ++k) step.fold({rest, still}, state);
  EXPECT_EQ(refinement::count_self_intersections(state.positions, subdivision.fine.faces), 0u);
}

TEST_F(FoldStepTest, AStartDrawsTheClothToItself) {
  options.gravity.setZero();
  FoldStep step = make();
  FoldState plain, started;
  Positions start = upsampled(rest);
  for (Eigen::Index i = 0; i < start.rows(); ++i) start(i, 1) += 5e-3f * std::cos(25 * start(i, 0));
  for (int k = 0; k < 10; ++k) {
    step.fold({rest, still}, plain);
    step.fold({rest, still, {}, {}, &start}, started);
  }
  EXPECT_LT((started.positions - start).norm(), 0.7f * (plain.positions - start).norm());
}

// An answer of a network that learnt from free simulations is not where the coarse cloth is.
TEST_F(FoldStepTest, AStartCarriesTheClothAwayFromTheCoarseOne) {
  options.gravity.setZero();
  FoldStep step = make();
  FoldState state;
  Positions start = upsampled(rest);
  step.fold({rest, still, {}, {}, &start}, state);
  for (int k = 0; k < 30; ++k) {
    start.col(1).array() += 2e-3f;  // 5 cm/s
    step.fold({rest, still, {}, {}, &start}, state);
  }
  EXPECT_LT((state.positions - start).rowwise().norm().mean(), 2e-3f);
}

TEST_F(FoldStepTest, FarFromTheOriginFoldsAreTheSame) {
  FoldStep step = make();
  const FoldState here = squeeze(step, 5);
  const RowVector3f offset(512, -256, 1024);  // exact in float32 to 0.06 mm
  FoldState there;
  Positions before = rest.rowwise() + offset;
  for (int k = 1; k <= 5; ++k) {
    Positions now = rest;
    now.col(0) *= 1 - 0.2f * static_cast<float>(std::min(k, 5)) / 5;
    for (Eigen::Index v = 0; v < now.rows(); ++v) now(v, 1) += 1e-3f * std::sin(40 * now(v, 0) + 3 * now(v, 2));
    const Positions moved = now.rowwise() + offset;
    step.fold({moved, (moved - before) / 0.04f}, there);
    before = moved;
  }
  EXPECT_LT(((there.positions.rowwise() - offset) - here.positions).rowwise().norm().mean(), 2e-3f);
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
           [](FoldOptions& o) { o.frame_time_s = 0; }, [](FoldOptions& o) { o.step_s = 0; },
           [](FoldOptions& o) { o.air_density = -1; }, [](FoldOptions& o) { o.material.density = 0; }}) {
    FoldOptions spoilt = options;
    spoil(spoilt);
    EXPECT_THROW(FoldStep(coarse, subdivision, {}, spoilt), Error);
  }
}

}  // namespace
}  // namespace pleat::fold
