// The processor's own tokens against Network::values, which is tested against plain loops.
#include "services/superres/kernels/token_executor.hpp"

#include <gtest/gtest.h>

#include "common/base/error.hpp"
#include "services/superres/networks/parts.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

using kernels::TokenExecutor;

/// Answers to one image after the other, each from what the one before left; the last two channels are constant.
std::vector<std::vector<float>> answers(const Network& network, int threads, const std::vector<torch::Tensor>& images,
                                        int channels, std::vector<float>& memory) {
  constexpr std::int64_t kConstants = 2;
  TokenExecutor executor(network.description(), parameters_of(network), threads);
  std::vector<std::vector<float>> result;
  for (const torch::Tensor& x : images) {
    const Size size{static_cast<int>(x.size(2)), static_cast<int>(x.size(3))};
    const Size fine = network.description().sizes(size).back();
    const auto own = x.slice(1, 0, x.size(1) - kConstants).contiguous();
    const auto constants = images[0].slice(1, x.size(1) - kConstants).contiguous();
    result.emplace_back(static_cast<std::size_t>(channels * fine.height * fine.width), -100.0F);
    executor.run(own.data_ptr<float>(), {constants.data_ptr<float>(), static_cast<std::size_t>(constants.numel())},
                 size, channels, result.back().data(), {memory, &memory});
  }
  return result;
}

/// Images of which the last two channels are constant.
std::vector<torch::Tensor> images_for(const Network& network, int count, int height, int width) {
  std::vector<torch::Tensor> images;
  const std::int64_t inputs = network.description().inputs;
  for (int n = 0; n < count; ++n) {
    images.push_back(example_input(1, inputs, height, width) * (1.0 + n));
    images[static_cast<std::size_t>(n)].slice(1, inputs - 2).copy_(images[0].slice(1, inputs - 2));
  }
  return images;
}

void expect_agreement(const Description& description, int height, int width) {
  ASSERT_TRUE(TokenExecutor::supports(description));
  const Network network = make_network(description);
  const auto images = images_for(network, 4, height, width);
  std::vector<float> memory;
  const auto result = answers(network, 1, images, description.outputs(), memory);
  torch::Tensor before;
  for (std::size_t n = 0; n < images.size(); ++n) {
    std::vector<int> wanted{description.values() - 1};
    if (description.remembers()) {
      if (n == 0) before = network.no_memory(images[n]);
      wanted.push_back(description.memory);
    }
    const auto values = network.values({images[n], before, {}}, wanted);
    if (description.remembers()) before = network.remember(before, values[1]);
    const auto own = torch::tensor(result[n]).reshape(values[0].sizes());
    EXPECT_LT((own - values[0]).abs().max().item<double>(), 2e-5 * (1 + values[0].abs().max().item<double>())) << n;
  }
  if (!description.remembers()) return;
  EXPECT_LT((torch::tensor(memory).reshape(before.sizes()) - before).abs().max().item<double>(), 1e-4);
}

Description with_history(int frames) {
  Ports ports;
  ports.inputs = 7, ports.outputs = 5, ports.scale = 2, ports.window = 3, ports.block = 3;
  return describe({"tokens", R"({"features": 6, "heads": 2, "hidden": 5, "history": )" + std::to_string(frames) + "}"},
                  ports);
}

/// Layers that no shipped network of tokens has: others are looked at, frames to come are hidden, weights are tied.
Description beside_others() {
  Description network(9);
  AttentionSizes sizes;
  sizes.features = 4, sizes.heads = 2, sizes.hidden = 3, sizes.frames = 3;
  const int tokens = network.add({.name = "tokens", .inputs = {0}, .channels = 12, .kernel = 1, .exact = true});
  const int others = network.add({.name = "others",
                                  .inputs = {0, tokens},
                                  .channels = 12,
                                  .kernel = 1,
                                  .activation = Activation::kTanh,
                                  .exact = true,
                                  .frames = 3});
  const int seen = add_cross_attention(network, "cross", tokens, others, false, sizes, -1);
  const int both = add_cross_attention(network, "cross_frames", tokens, others, true, sizes, seen);
  const int own = add_attention(network, "causal", both, true, true, sizes, -1);
  const int code = network.add({.name = "code",
                                .inputs = {own},
                                .channels = 8,
                                .kernel = 1,
                                .activation = Activation::kLeakyRelu,
                                .exact = true});
  const int back =
      network.add({.name = "back", .inputs = {code}, .channels = 12, .kernel = 1, .exact = true, .tied = "code"});
  const int shaped = network.add({.kind = LayerKind::kPart, .inputs = {back}, .channels = 8, .first = 4});
  const int joined = network.add({.kind = LayerKind::kJoin, .inputs = {shaped, tokens}});
  const int kept = network.add({.name = "kept",
                                .inputs = {joined},
                                .channels = 8,
                                .kernel = 1,
                                .activation = Activation::kPrelu,
                                .exact = true});
  const int large = network.add({.kind = LayerKind::kPixelShuffle, .inputs = {kept}, .factor = 2});
  network.add({.kind = LayerKind::kUnshuffle, .inputs = {large}, .factor = 2});
  return network;
}

TEST(TokenExecutor, AgreesWithTheNetwork) {
  for (const char* modules : {"", R"(, "spatial": false)", R"(, "temporal": false)", R"(, "blocks": 0)"}) {
    expect_agreement(small_tokens(modules), 1, 11);
  }
  expect_agreement(small_tokens(), 3, 70);  // more places than are worked on at once
  expect_agreement(with_history(1), 1, 11);
  expect_agreement(with_history(3), 1, 70);
  expect_agreement(beside_others(), 2, 5);
}

TEST(TokenExecutor, ThreadsAndFurtherChannelsChangeNoBit) {
  const Network network = make_network(
      describe({"tokens", R"({"features": 32, "heads": 4, "hidden": 64, "history": 1})"}, {20, 3, 2, true, 3, 3}));
  const auto images = images_for(network, 2, 1, 330);
  std::vector<float> memory, other;
  const auto one = answers(network, 1, images, 3, memory), three = answers(network, 3, images, 3, other);
  EXPECT_EQ(one, three);
  EXPECT_EQ(memory, other);
  other.clear();
  const auto first = answers(network, 2, images, 1, other);
  EXPECT_TRUE(std::equal(first[1].begin(), first[1].end(), one[1].begin()));
}

TEST(TokenExecutor, LeavesOthersToOthers) {
  EXPECT_FALSE(TokenExecutor::supports(small_mfsr("subpixel")));
  EXPECT_FALSE(TokenExecutor::supports(small_unet("bilinear")));
  const Network network = make_network(small_tokens());
  EXPECT_THROW(TokenExecutor(
                   network.description(), [](const std::string&) { return std::span<const float>(); }, 1),
               Error);
  TokenExecutor executor(with_history(1), parameters_of(make_network(with_history(1))), 1);
  std::vector<float> x(7 * 4), answer(5 * 16), memory(3);
  EXPECT_THROW(executor.run(x.data(), {}, {1, 4}, 5, answer.data(), {memory, nullptr}), Error);
}

}  // namespace
}  // namespace pleat::superres
