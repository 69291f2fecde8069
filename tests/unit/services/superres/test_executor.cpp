// The processor's own kernels against Network::forward, which is tested against plain loops.
#include <gtest/gtest.h>

#include <atomic>

#include "common/base/error.hpp"
#include "services/superres/bundle.hpp"
#include "services/superres/cpu/executor.hpp"
#include "services/superres/cpu/team.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

/// The largest difference between the executor's answer and Network::forward.
double difference(const Network& network, const cpu::ExecutorOptions& options, int height, int width, int channels) {
  cpu::Executor executor(network.architecture(), arrays_of(network.to_script()), options);
  const auto x = example_input(2, height, width).contiguous();
  const auto expected = network.forward(x).detach().contiguous();
  double worst = 0;
  for (std::int64_t n = 0; n < 2; ++n) {
    auto actual = torch::full({channels, 4 * height, 4 * width}, -100.0);
    executor.run(x[n].data_ptr<float>(), height, width, channels, actual.data_ptr<float>());
    worst = std::max(worst, (actual - expected[n].slice(0, 0, channels)).abs().max().item<double>());
  }
  return worst;
}

/// Root mean square of bfloat16's rounding over that of what the network adds to its base.
double relative_rounding(const Network& network, int height, int width) {
  const cpu::Arrays arrays = arrays_of(network.to_script());
  const auto x = example_input(1, height, width).contiguous();
  const auto exact = network.forward(x).detach();
  auto rounded = torch::empty_like(exact);
  cpu::Executor(network.architecture(), arrays, {true, 2, false})
      .run(x.data_ptr<float>(), height, width, kChannels, rounded.data_ptr<float>());
  const std::string& residual = network.architecture().residual;
  auto added = exact;
  if (residual == "bilinear") added = exact - upsample_bilinear(x);
  if (residual == "mesh") added = exact - network.base_image(x);
  return ((rounded - exact).square().mean() / added.square().mean()).sqrt().item<double>();
}

class ExecutorVariants : public testing::TestWithParam<Architecture> {};

TEST_P(ExecutorVariants, AgreesWithTheNetwork) {
  // Neither a multiple of a tile nor of a vector; growth and features are padded to vectors.
  const int height = 9, width = 13;
  const Network network = make_network(GetParam(), height, width);
  for (const bool base : {true, false}) {
    for (const int threads : {1, 3}) {
      for (const int channels : {3, 9}) {
        EXPECT_LT(difference(network, {false, threads, base}, height, width, channels), 2e-5)
            << base << " " << threads << " " << channels;
      }
    }
  }
  if (cpu::has_bfloat16()) {
    const double rounding = relative_rounding(network, height, width);
    EXPECT_LT(rounding, 0.03);
    EXPECT_GT(rounding, 1e-5);
  }
}

INSTANTIATE_TEST_SUITE_P(All, ExecutorVariants,
                         testing::Values(small("bilinear", "none", false), small("bilinear", "bilinear", true),
                                         small("subpixel", "bilinear", true), small("subpixel", "mesh", true),
                                         small("subpixel", "mesh", true, "local"),
                                         small("bilinear", "mesh", true, "local"),
                                         small("bilinear", "none", false, "aligned", "srresnet"),
                                         small("subpixel", "mesh", true, "local", "srresnet"),
                                         Architecture{1, 1, 40, 70}));

TEST(Executor, ServesImagesOfManySizes) {
  const Network network = make_network(small("subpixel", "bilinear", true));
  for (const auto& [height, width] : {std::pair{2, 2}, std::pair{4, 4}, std::pair{3, 50}, std::pair{21, 8}}) {
    EXPECT_LT(difference(network, {false, 2, false}, height, width, 9), 2e-5) << height << "x" << width;
  }
}

TEST(Executor, SaysWhatItDoesNotSupport) {
  const Network chen = make_network(small("subpixel", "none", false, "aligned", "chen2018"));
  EXPECT_FALSE(cpu::Executor::supports(chen.architecture(), arrays_of(chen.to_script())));
  const Network network = make_network(small("subpixel", "mesh", true, "local"));
  cpu::Arrays arrays = arrays_of(network.to_script());
  EXPECT_TRUE(cpu::Executor::supports(network.architecture(), arrays));
  arrays.erase("block1_dense2_bias");
  EXPECT_THROW(cpu::Executor(network.architecture(), arrays, {}), Error);
  arrays.erase("base_vertex_texels");
  EXPECT_FALSE(cpu::Executor::supports(network.architecture(), arrays));
}

TEST(Team, MembersMeetAtBarriers) {
  constexpr int kMembers = 4, kRounds = 200;
  cpu::Team team(kMembers);
  std::atomic<int> early{0};
  std::vector<std::atomic<int>> rounds(kMembers);
  for (int task = 0; task < 3; ++task) {
    for (auto& round : rounds) round = 0;
    team.run([&](int member) {
      for (int round = 1; round <= kRounds; ++round) {
        rounds[static_cast<std::size_t>(member)] = round;
        team.barrier();
        for (const auto& other : rounds) early += other.load() < round ? 1 : 0;
        team.barrier();
      }
    });
    for (const auto& round : rounds) EXPECT_EQ(round.load(), kRounds);
  }
  EXPECT_EQ(early.load(), 0);
}

}  // namespace
}  // namespace pleat::superres
