// Small networks for tests.
#pragma once

#include <gtest/gtest.h>
#include <torch/script.h>
#include <torch/torch.h>

#include <span>
#include <string>

#include "services/superres/kernels/forward.hpp"
#include "services/superres/networks/network.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

inline Description small_mfsr(const std::string& upsampling) {
  return describe(
      {"mfsr", R"({"blocks": 2, "layers": 3, "growth": 4, "features": 6, "upsampling": ")" + upsampling + "\"}"},
      {7, 3, 4, false});
}

inline Description small_srresnet(const std::string& upsampling) {
  return describe({"srresnet", R"({"blocks": 2, "features": 6, "upsampling": ")" + upsampling + "\"}"},
                  {7, 3, 4, false});
}

/// Of three frames. modules: further options, beginning with a comma.
inline Description small_tokens(const std::string& modules = "") {
  return describe({"tokens", R"({"blocks": 2, "features": 6, "heads": 2, "hidden": 5)" + modules + "}"},
                  {7, 3, 4, false, 3});
}

inline Description small_unet(const std::string& upsampling) {
  return describe(
      {"unet", R"({"levels": 2, "layers": 2, "growth": 4, "features": 6, "upsampling": ")" + upsampling + "\"}"},
      {7, 3, 4, false});
}

/// Every kind of layer of images: the same value read with and without others, at three sizes.
inline Description several_scales() {
  Description network(5);
  const int first = network.add({.name = "first", .inputs = {0}, .channels = 6, .exact = true});
  const int half = network.add({.kind = LayerKind::kPool, .inputs = {first}, .factor = 2});
  const int wide = network.add({.name = "wide", .inputs = {half}, .channels = 12, .activation = Activation::kRelu});
  const int quarter = network.add({.kind = LayerKind::kPool, .inputs = {wide}, .factor = 2});
  const int deep = network.add({.name = "deep", .inputs = {quarter}, .channels = 12, .kernel = 1});
  const int back = network.add({.kind = LayerKind::kResize, .inputs = {deep}, .like = wide});
  const int both =
      network.add({.name = "both", .inputs = {back, wide}, .channels = 24, .activation = Activation::kRelu});
  const int shuffled = network.add({.kind = LayerKind::kPixelShuffle, .inputs = {both}, .factor = 2});
  const int again = network.add({.kind = LayerKind::kResize, .inputs = {shuffled}, .like = first});
  const int last = network.add({.name = "last", .inputs = {first, again}, .channels = 6, .add = first});
  const int fine = network.add({.kind = LayerKind::kUpsample, .inputs = {last}, .factor = 4});
  network.add({.name = "answer", .inputs = {fine}, .channels = 3});
  return network;
}

/// Weights that begin at zero get values, or they would hide everything before them.
inline Network make_network(const Description& description) {
  Network network(description, 5);
  const torch::NoGradGuard no_grad;
  for (auto [name, value] : network.parameters()) {
    if (value.abs().max().item<double>() == 0) {
      value.copy_(torch::linspace(-0.2, 0.3, value.numel()).view(value.sizes()));
    }
  }
  return network;
}

/// As the processor's own kernels ask for them.
inline kernels::FindValues parameters_of(const Network& network) {
  return [&network](const std::string& name) {
    for (const auto& [key, value] : network.parameters()) {
      if (key == name) return std::span<const float>(value.data_ptr<float>(), static_cast<std::size_t>(value.numel()));
    }
    return std::span<const float>();
  };
}

inline torch::Tensor example_input(std::int64_t batch, std::int64_t channels, std::int64_t height, std::int64_t width) {
  const auto ramp = torch::arange(batch * channels * height * width, torch::kFloat32);
  return (0.5 + 0.45 * torch::sin(ramp * 0.37)).view({batch, channels, height, width});
}

/// The script of a network that remembers goes on from its own answers as the network does.
inline void expect_script_remembers(const Network& network, const torch::Tensor& x, int frames) {
  const Description& d = network.description();
  auto module = network.to_script();
  auto memory = network.no_memory(x), own = memory;
  for (int frame = 0; frame < frames; ++frame) {
    const auto values = network.values({x * (1.0 + frame), memory, {}}, {d.values() - 1, d.memory});
    memory = network.remember(memory, values[1]);
    const auto both = module.forward({x * (1.0 + frame), own}).toTuple();
    own = both->elements()[1].toTensor();
    EXPECT_LT((both->elements()[0].toTensor() - values[0]).abs().max().item<double>(), 1e-5);
    EXPECT_LT((own - memory).abs().max().item<double>(), 1e-5);
  }
}

}  // namespace pleat::superres
