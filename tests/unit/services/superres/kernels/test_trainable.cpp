// The own kernels' gradients against LibTorch's.
#include "services/superres/kernels/trainable.hpp"

#include <gtest/gtest.h>

#include "services/superres/kernels/kernels.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

constexpr int kHeight = 9, kWidth = 13;  // no whole tiles

struct Pass {
  torch::Tensor output;
  std::vector<torch::Tensor> gradients;
};

Pass run(const Description& description, int own_threads, torch::ScalarType type) {
  Network network = make_network(description);
  if (own_threads > 0) network.use_own_kernels(own_threads);
  const auto x = example_input(3, description.inputs, kHeight, kWidth);
  Pass pass;
  pass.output = network.forward(x, type);
  // A gradient that differs everywhere.
  const auto weight = torch::sin(torch::arange(pass.output.numel(), torch::kFloat32) * 0.011).view_as(pass.output);
  (pass.output * weight).sum().backward();
  for (const auto& [name, value] : network.parameters()) pass.gradients.push_back(value.grad().clone());
  return pass;
}

double relative(const torch::Tensor& a, const torch::Tensor& b) {
  return ((a - b).square().sum() / b.square().sum().clamp_min(1e-20)).sqrt().item<double>();
}

class TrainableVariants : public testing::TestWithParam<Description> {};

TEST_P(TrainableVariants, HasTheGradientsOfLibTorch) {
  ASSERT_TRUE(kernels::Trainable::supports(GetParam()));
  const Pass expected = run(GetParam(), 0, torch::kFloat32);
  for (const int threads : {1, 2}) {
    const Pass own = run(GetParam(), threads, torch::kFloat32);
    EXPECT_LT(relative(own.output, expected.output), 1e-5);
    for (std::size_t i = 0; i < own.gradients.size(); ++i) {
      EXPECT_LT(relative(own.gradients[i], expected.gradients[i]), 2e-4) << i << ", threads " << threads;
    }
  }
  if (!kernels::has_bfloat16()) return;
  // Rounding is noise on gradients that are themselves sums of both signs here. The mean over the parameters is
  // compared with what LibTorch's own bfloat16 does.
  const Pass rounded = run(GetParam(), 2, torch::kBFloat16), libtorch = run(GetParam(), 0, torch::kBFloat16);
  double own_error = 0, other_error = 0;
  for (std::size_t i = 0; i < rounded.gradients.size(); ++i) {
    own_error += relative(rounded.gradients[i], expected.gradients[i]);
    other_error += relative(libtorch.gradients[i], expected.gradients[i]);
  }
  EXPECT_LT(own_error, 10 * other_error);
  EXPECT_LT(own_error, 0.1 * static_cast<double>(rounded.gradients.size()));
}

INSTANTIATE_TEST_SUITE_P(
    All, TrainableVariants,
    testing::Values(small_mfsr("subpixel"), small_mfsr("bilinear"), small_srresnet("subpixel"),
                    small_srresnet("bilinear"), small_unet("subpixel"), small_unet("bilinear"), several_scales(),
                    describe({"mfsr", R"({"blocks": 1, "layers": 1, "growth": 40, "features": 20})"}, {5, 3, 4, false}),
                    describe({"mfsr", R"({"blocks": 3, "layers": 2, "growth": 16, "features": 32,
                                                               "upsampling": "subpixel"})"},
                             {49, 3, 2, true})));

TEST(Trainable, GradientsAddUpAndWithoutGradientsNothingIsKept) {
  Network network = make_network(small_mfsr("subpixel"));
  network.use_own_kernels(1);
  const auto x = example_input(2, network.description().inputs, kHeight, kWidth);
  network.forward(x).sum().backward();
  const auto once = network.parameters()[0].second.grad().clone();
  network.forward(x).sum().backward();
  EXPECT_LT(relative(network.parameters()[0].second.grad(), 2 * once), 1e-6);
  const torch::NoGradGuard no_grad;
  EXPECT_FALSE(network.forward(x).requires_grad());
}

TEST(Trainable, LeavesOthersToLibTorch) {
  EXPECT_FALSE(kernels::Trainable::supports(describe({"chen2018", "{}"}, {3, 3, 4, false})));
  EXPECT_FALSE(kernels::Trainable::supports(describe({"mfsr", R"({"growth": 200})"}, {9, 9, 4, false})));
}

}  // namespace
}  // namespace pleat::superres
