// What networks of images remember of their own answers.
#include "services/superres/networks/parts.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "services/superres/networks/network.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

constexpr int kInputs = 5, kOutputs = 3, kScale = 2, kFrames = 2;

Description with_history(const std::string& kind, const std::string& upsampling) {
  Ports ports;
  ports.inputs = kInputs;
  ports.outputs = kOutputs;
  ports.scale = kScale;
  ports.detail = true;
  return describe({kind, R"({"blocks": 1, "layers": 2, "growth": 4, "features": 4, "history": )" +
                             std::to_string(kFrames) + R"(, "upsampling": ")" + upsampling + "\"}"},
                  ports);
}

class ImageHistory : public testing::TestWithParam<std::tuple<const char*, const char*>> {
 protected:
  Description description() const { return with_history(std::get<0>(GetParam()), std::get<1>(GetParam())); }
};

TEST_P(ImageHistory, IsItsLastAnswers) {
  const Network network = make_network(description());
  const Description& d = network.description();
  const auto x = example_input(1, kInputs, 4, 6);
  const auto memory = network.no_memory(x);
  EXPECT_EQ(memory.sizes(), (std::vector<std::int64_t>{1, kFrames * kOutputs * kScale * kScale, 4, 6}));
  const auto values = network.values({x, memory, {}}, {d.values() - 1, d.memory});
  EXPECT_EQ(values[0].sizes(), (std::vector<std::int64_t>{1, kOutputs, kScale * 4, kScale * 6}));
  const auto left = network.values({x, {}, values[0]}, {d.given_memory}).front();
  EXPECT_TRUE(left.equal(values[1])) << "what an answer leaves is what a true one like it would leave";
  const auto next = network.values({x, network.remember(memory, left), {}}, {d.values() - 1}).front();
  EXPECT_FALSE(next.allclose(values[0])) << "the last answer is read";
}

TEST_P(ImageHistory, TheScriptIsTheSameFunction) {
  expect_script_remembers(make_network(description()), example_input(1, kInputs, 4, 6), 3);
}

TEST_P(ImageHistory, BeginsAtTheUpsampledMesh) {
  const Network network(description(), 3);
  const auto x = example_input(1, kInputs, 4, 6);
  const auto memory = torch::ones_like(network.no_memory(x));
  EXPECT_EQ(network.values({x, memory, {}}, {network.description().values() - 1}).front().abs().max().item<double>(),
            0);
}

INSTANTIATE_TEST_SUITE_P(Networks, ImageHistory,
                         testing::Combine(testing::Values("mfsr", "unet"), testing::Values("bilinear", "subpixel")));

}  // namespace
}  // namespace pleat::superres
