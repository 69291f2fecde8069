// What networks remember of their own answers.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/script.h>

#include "services/superres/networks/network.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

constexpr int kInputs = 7, kOutputs = 5, kScale = 2, kBlock = 3;

Description with_history(int frames) {
  Ports ports;
  ports.inputs = kInputs;
  ports.outputs = kOutputs;
  ports.scale = kScale;
  ports.detail = true;
  ports.window = 3;
  ports.block = kBlock;
  return describe(
      {"tokens", R"({"blocks": 1, "features": 6, "heads": 2, "hidden": 5, "history": )" + std::to_string(frames) + "}"},
      ports);
}

TEST(History, IsTheFirstThreeChannelsOfItsAnswers) {
  const Network network = make_network(with_history(2));
  const Description& d = network.description();
  const auto x = example_input(2, kInputs, 1, 4);
  const auto memory = network.no_memory(x);
  EXPECT_EQ(memory.sizes(), (std::vector<std::int64_t>{2, 2 * 3 * kBlock, 1, 4}));
  const auto values = network.values({x, memory, {}}, {d.values() - 1, d.memory});
  const auto left = network.values({x, {}, values[0]}, {d.given_memory}).front();
  EXPECT_TRUE(left.equal(values[1])) << "what an answer leaves is what a true one like it would leave";
  // Place 3 of each square of 2 x 2 is padding.
  for (int c = 0; c < 3; ++c) {
    for (int i = 0; i < kBlock; ++i) {
      EXPECT_TRUE(values[1]
                      .select(1, c * kBlock + i)
                      .equal(values[0].select(1, c).slice(1, i / 2, 2, 2).slice(2, i % 2, 8, 2)));
    }
  }
}

TEST(History, TheScriptIsTheSameFunction) {
  expect_script_remembers(make_network(with_history(2)), example_input(1, kInputs, 1, 4), 4);
}

TEST(History, BeginsAtTheUpsampledMesh) {
  const Network network(with_history(1), 3);
  const Description& d = network.description();
  const auto x = example_input(1, kInputs, 1, 4);
  const auto memory = torch::ones_like(network.no_memory(x));
  EXPECT_EQ(network.values({x, memory, {}}, {d.values() - 1}).front().abs().max().item<double>(), 0);
}

TEST(History, DoesNotGrowWithoutBounds) {
  const Network network = make_network(with_history(1));
  auto module = network.to_script();
  const auto x = 1e6 * example_input(1, kInputs, 1, 4);
  const auto memory = network.no_memory(x);
  const auto both = module.forward({x, memory}).toTuple();
  EXPECT_GT(both->elements()[0].toTensor().abs().max().item<double>(), 1e3);
  EXPECT_EQ(both->elements()[1].toTensor().abs().max().item<double>(), kMemoryLimit);
  const auto newest = network.values({x, memory, {}}, {network.description().memory}).front();
  EXPECT_EQ(network.remember(memory, newest).abs().max().item<double>(), kMemoryLimit);
}

TEST(History, ANetworkWithoutItRemembersNothing) {
  const Description d = with_history(0);
  EXPECT_FALSE(d.remembers());
  EXPECT_EQ(d.memory_shape({1, 4}), (std::array<int, 3>{0, 0, 0}));
}

/// Frames see themselves and older ones.
TEST(Attention, CausalLooksBackOnly) {
  Description d(2 * 3 * 4);
  d.add({.kind = LayerKind::kAttention, .inputs = {0}, .frames = 2, .heads = 2, .over_frames = true, .causal = true});
  const Network network(d, 1);
  auto x = example_input(1, d.inputs, 1, 3);
  const auto before = network.forward(x);
  x = x.clone();
  x.slice(1, 12) += 1;  // the newer frame
  const auto after = network.forward(x);
  EXPECT_TRUE(after.slice(1, 0, 4).equal(before.slice(1, 0, 4)));
  EXPECT_FALSE(after.slice(1, 4).equal(before.slice(1, 4)));
}

}  // namespace
}  // namespace pleat::superres
