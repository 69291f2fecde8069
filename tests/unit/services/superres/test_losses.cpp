// Losses against plain loops, their gradients against finite differences, and the kinematic relation on real motion.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>

#include "services/superres/training/losses.hpp"

namespace pleat::superres {
namespace {

constexpr int kWindows = 2, kFrames = 3, kHeight = 4, kWidth = 8;
constexpr double kFrameTime = 0.04;

torch::Tensor rotation(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return torch::tensor({c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0}, torch::kFloat64).view({3, 3});
}

/// In double, so that finite differences are sharp.
Batch example_batch() {
  torch::manual_seed(3);
  const auto options = torch::kFloat64;
  Batch batch;
  batch.frames = kFrames;
  const std::int64_t n = kWindows * kFrames;
  batch.coarse = torch::rand({n, 9, kHeight / 4, kWidth / 4}, options);
  batch.fine = torch::rand({n, 9, kHeight, kWidth}, options);
  batch.mask = torch::ones({n, 1, kHeight, kWidth}, options);
  batch.mask.index_put_({torch::indexing::Slice(), 0, 0, torch::indexing::Slice(0, 3)}, 0);
  std::vector<torch::Tensor> rotations;
  for (int i = 0; i < n; ++i) rotations.push_back(rotation(0.1 * i));
  batch.rotations = torch::stack(rotations);
  return batch;
}

LossConstants example_constants() {
  LossConstants c;
  c.minimum = torch::linspace(-2, -1, 9, torch::kFloat64);
  c.range = torch::linspace(1, 3, 9, torch::kFloat64);
  c.deviation = torch::linspace(0.1, 0.5, 9, torch::kFloat64);
  c.frame_time_s = kFrameTime;
  return c;
}

LossConfig config_of(const char* target, const char* alignment, const char* scaling) {
  LossConfig config;
  config.frames = kFrames - 1;
  config.target = target, config.alignment = alignment, config.scaling = scaling;
  config.displacement = 0.9, config.normal = 0.2, config.velocity = 0.3, config.kinematic = 0.4;
  return config;
}

/// Eq. 2-6 spelled out texel by texel.
double plain_total(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                   const LossConfig& config) {
  const auto s = synthesized.accessor<double, 4>(), f = batch.fine.accessor<double, 4>();
  const auto m = batch.mask.accessor<double, 4>();
  const auto r = batch.rotations.accessor<double, 3>();
  const auto minimum = constants.minimum.accessor<double, 1>(), range = constants.range.accessor<double, 1>();
  const auto deviation = constants.deviation.accessor<double, 1>();
  const bool scaled = config.scaling == "deviation", exact = config.alignment == "exact";
  double sums[3] = {}, texels = 0, kinematic = 0, kinematic_texels = 0, length = 0;
  for (int c = 0; c < 3; ++c) length += range[c] * (scaled ? deviation[c] : 1) / 3;
  for (int n = 0; n < kWindows * kFrames; ++n) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (m[n][0][y][x] == 0) continue;
        texels += 3;
        for (int c = 0; c < 9; ++c) {
          sums[c / 3] += std::pow((s[n][c][y][x] - f[n][c][y][x]) / (scaled ? deviation[c] : 1), 2);
        }
      }
    }
  }
  for (int w = 0; w < kWindows; ++w) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (m[w * kFrames][0][y][x] == 0) continue;
        kinematic_texels += 3;
        // World vectors of the synthesized frame, or of its error, from channels [first, first + 3) of frame k.
        const auto vector = [&](int k, int first, bool truth, int axis) {
          const int n = w * kFrames + k;
          const auto value = [&](int c) {
            const double own = (truth ? f : s)[n][first + c][y][x] * range[first + c] + minimum[first + c];
            const double zero = exact ? f[n][first + c][y][x] * range[first + c] + minimum[first + c] : 0.0;
            return own - zero;
          };
          if (!exact) return value(axis);
          return r[n][0][axis] * value(0) + r[n][1][axis] * value(1) + r[n][2][axis] * value(2);
        };
        for (int k = 1; k < kFrames; ++k) {
          for (int axis = 0; axis < 3; ++axis) {
            double residual = vector(k, 0, config.target == "ground_truth", axis) - vector(0, 0, false, axis);
            for (int j = 1; j <= k; ++j) residual -= kFrameTime * vector(j, 6, false, axis);
            kinematic += std::pow(residual / length, 2);
          }
        }
      }
    }
  }
  return (config.displacement * sums[0] + config.normal * sums[1] + config.velocity * sums[2]) / texels +
         config.kinematic * kinematic / kinematic_texels;
}

class LossVariants : public testing::TestWithParam<std::tuple<const char*, const char*, const char*>> {
 protected:
  LossConfig config() const {
    return config_of(std::get<0>(GetParam()), std::get<1>(GetParam()), std::get<2>(GetParam()));
  }
};

TEST_P(LossVariants, AgreeWithPlainLoopsAndFiniteDifferences) {
  const Batch batch = example_batch();
  const LossConstants constants = example_constants();
  auto synthesized = torch::rand({kWindows * kFrames, 9, kHeight, kWidth}, torch::kFloat64);
  const double expected = plain_total(synthesized, batch, constants, config());
  synthesized.set_requires_grad(true);
  const auto total = compute_losses(synthesized, batch, constants, config()).total;
  EXPECT_NEAR(total.item<double>(), expected, 1e-10 * expected);

  total.backward();
  const auto gradient = synthesized.grad().clone();
  synthesized.set_requires_grad(false);
  const double step = 1e-5;
  for (std::int64_t i = 0; i < synthesized.numel(); i += 37) {
    auto moved = synthesized.clone();
    moved.view({-1})[i] += step;
    const double up = plain_total(moved, batch, constants, config());
    moved.view({-1})[i] -= 2 * step;
    const double down = plain_total(moved, batch, constants, config());
    const double analytic = gradient.view({-1})[i].item<double>();
    EXPECT_NEAR((up - down) / (2 * step), analytic, 1e-7 + 1e-5 * std::abs(analytic)) << i;
  }
}

INSTANTIATE_TEST_SUITE_P(All, LossVariants,
                         testing::Combine(testing::Values("synthesized", "ground_truth"),
                                          testing::Values("exact", "shared"), testing::Values("none", "deviation")));

/// A point that moves and a frame of reference that turns: the true images have no kinematic loss in exact alignment.
TEST(Losses, TrueMotionHasNoKinematicLoss) {
  Batch batch = example_batch();
  const LossConstants constants = example_constants();
  const LossConfig config = config_of("synthesized", "exact", "none");
  const Losses losses = compute_losses(batch.fine, batch, constants, config);
  EXPECT_NEAR(losses.kinematic.item<double>(), 0, 1e-20);
  EXPECT_NEAR(losses.total.item<double>(), 0, 1e-20);
  // A world displacement of all frames alike keeps the relation: turn it into each frame's own axes.
  auto shifted = batch.fine.clone();
  const auto world = torch::tensor({0.1, -0.2, 0.3}, torch::kFloat64);
  for (std::int64_t n = 0; n < shifted.size(0); ++n) {
    const auto own = torch::matmul(batch.rotations[n], world) / constants.range.slice(0, 0, 3);
    shifted[n].slice(0, 0, 3) += own.view({3, 1, 1});
  }
  EXPECT_NEAR(compute_losses(shifted, batch, constants, config).kinematic.item<double>(), 0, 1e-20);
  // One frame that jumps does not.
  shifted[1].slice(0, 0, 3) += 0.1;
  EXPECT_GT(compute_losses(shifted, batch, constants, config).kinematic.item<double>(), 1e-4);
}

TEST(Losses, TexelsOutsideTheMaskDoNotCount) {
  const Batch batch = example_batch();
  const LossConstants constants = example_constants();
  const LossConfig config = config_of("synthesized", "exact", "none");
  auto a = torch::rand_like(batch.fine);
  const double before = compute_losses(a, batch, constants, config).total.item<double>();
  a = a + 100 * (1 - batch.mask);
  EXPECT_DOUBLE_EQ(compute_losses(a, batch, constants, config).total.item<double>(), before);
}

TEST(Losses, SingleFramesHaveNoKinematicLoss) {
  Batch batch = example_batch();
  batch.frames = 1;
  const auto a = torch::rand_like(batch.fine);
  const LossConfig config = config_of("synthesized", "exact", "none");
  EXPECT_EQ(compute_losses(a, batch, example_constants(), config).kinematic.item<double>(), 0);
}

}  // namespace
}  // namespace pleat::superres
