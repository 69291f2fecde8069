// The processor's own kernels against Network::forward, which is tested against plain loops.
#include "services/superres/kernels/executor.hpp"

#include <gtest/gtest.h>

#include "common/base/error.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

/// The executor's answers to two images of which the last `constants` channels are constant.
torch::Tensor answers(const Network& network, const kernels::ExecutorOptions& options, const torch::Tensor& x,
                      int constants, int channels) {
  kernels::Executor executor(network.description(), parameters_of(network), options);
  const Size size{static_cast<int>(x.size(2)), static_cast<int>(x.size(3))};
  const Size fine = network.description().sizes(size).back();
  auto result = torch::full({x.size(0), channels, fine.height, fine.width}, -100.0);
  const auto own = x.slice(1, 0, x.size(1) - constants).contiguous();
  const auto constant = x[0].slice(0, x.size(1) - constants).contiguous();
  for (std::int64_t n = 0; n < x.size(0); ++n) {
    executor.run(own[n].data_ptr<float>(), {constant.data_ptr<float>(), static_cast<std::size_t>(constant.numel())},
                 size, channels, result[n].data_ptr<float>());
  }
  return result;
}

double difference(const Network& network, const kernels::ExecutorOptions& options, int height, int width, int constants,
                  int channels) {
  auto x = example_input(2, network.description().inputs, height, width);
  if (constants > 0) x[1].slice(0, x.size(1) - constants).copy_(x[0].slice(0, x.size(1) - constants));
  const auto expected = network.forward(x).detach().slice(1, 0, channels);
  return (answers(network, options, x, constants, channels) - expected).abs().max().item<double>();
}

class ExecutorVariants : public testing::TestWithParam<Description> {};

TEST_P(ExecutorVariants, AgreesWithTheNetwork) {
  // Neither a multiple of a tile nor of a vector; growth and features are padded to vectors.
  const int height = 9, width = 13;
  const Network network = make_network(GetParam());
  for (const bool base : {true, false}) {
    for (const int threads : {1, 3}) {
      for (const int channels : {1, GetParam().outputs()}) {
        EXPECT_LT(difference(network, {false, threads, base}, height, width, threads - 1, channels), 2e-5)
            << base << " " << threads << " " << channels;
      }
    }
  }
  if (!kernels::has_bfloat16()) return;
  const auto x = example_input(1, GetParam().inputs, height, width);
  const auto exact = network.forward(x).detach();
  for (const bool base : {true, false}) {
    const auto rounded = answers(network, {true, 2, base}, x, 0, GetParam().outputs());
    const double rounding = ((rounded - exact).square().mean() / exact.square().mean()).sqrt().item<double>();
    EXPECT_LT(rounding, 0.03) << base;
    EXPECT_GT(rounding, 1e-5) << base;
  }
}

INSTANTIATE_TEST_SUITE_P(All, ExecutorVariants,
                         testing::Values(small_mfsr("subpixel"), small_mfsr("bilinear"), small_srresnet("subpixel"),
                                         small_srresnet("bilinear"), small_unet("subpixel"), small_unet("bilinear"),
                                         several_scales(),
                                         describe({"chen2018", R"({"blocks": 2, "features": 6})"}, {3, 3, 4, false}),
                                         describe({"mfsr", R"({"blocks": 1, "layers": 1, "growth": 40,
                                                               "features": 70})"},
                                                  {9, 9, 4, false})));

TEST(Executor, WholeTilesAndPartsOfThemAgree) {
  if (!kernels::has_bfloat16()) return;
  // 54 tiles and rows of 36 pixels: more rows than one of AMX's tiles has; channels in one, two and three times 32.
  const Network network = make_network(
      describe({"mfsr", R"({"blocks": 2, "layers": 2, "growth": 32, "features": 32, "upsampling": "subpixel"})"},
               {9, 3, 2, true}));
  const auto x = example_input(2, 9, 24, 36);
  const auto exact = network.forward(x).detach();
  const auto relative = [](const torch::Tensor& a, const torch::Tensor& b) {
    return ((a - b).square().mean() / b.square().mean()).sqrt().item<double>();
  };
  for (const int threads : {1, 2}) {
    const auto best = answers(network, {true, threads, false}, x, 0, 3),
               base = answers(network, {true, threads, true}, x, 0, 3);
    EXPECT_LT(relative(best, exact), 0.03);
    EXPECT_LT(relative(base, exact), 0.03);
    // The same factors, added up in another order.
    EXPECT_LT(relative(best, base), 0.3 * relative(base, exact));
  }
}

TEST(Executor, ServesImagesOfManySizes) {
  const Network network = make_network(small_mfsr("subpixel"));
  for (const auto& [height, width] : {std::pair{2, 2}, std::pair{4, 4}, std::pair{3, 50}, std::pair{21, 8}}) {
    EXPECT_LT(difference(network, {false, 2, false}, height, width, 0, 3), 2e-5) << height << "x" << width;
  }
}

TEST(Executor, NamesAParameterOfAnotherSize) {
  const Network network = make_network(small_mfsr("subpixel"));
  const auto all = parameters_of(network);
  const auto some = [&](const std::string& name) {
    return name == "block1_dense2_bias" ? std::span<const float>() : all(name);
  };
  try {
    kernels::Executor(network.description(), some, {});
    FAIL();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("block1_dense2_bias"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace pleat::superres
