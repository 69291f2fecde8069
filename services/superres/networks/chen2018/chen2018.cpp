#include "services/superres/networks/chen2018/chen2018.hpp"

#include <bit>
#include <string>

#include "common/base/error.hpp"
#include "services/superres/networks/parts.hpp"

namespace pleat::superres {

Description describe_chen2018(Options& options, const Ports& ports) {
  const int blocks = options.integer("blocks", 16, 1, 64), width = options.integer("features", 64, 1, 512);
  const auto scale = static_cast<unsigned>(ports.scale);
  if (!std::has_single_bit(scale)) {
    throw_invalid_argument("architecture: kind 'chen2018' has stages of factor two, scale " +
                           std::to_string(ports.scale) + " is no power of two");
  }

  Description network(ports.inputs);
  const int shallow = network.add(
      {.name = "shallow0", .inputs = {0}, .channels = width, .activation = Activation::kPrelu, .exact = true});
  int features = add_residual_blocks(network, shallow, blocks);
  features = network.add({.name = "global1", .inputs = {features}, .channels = width, .add = shallow});
  for (int stage = 0; stage < std::countr_zero(scale); ++stage) {
    // The paper's slopes, one a channel, come after the shuffle; here each texel that a channel falls into has one.
    constexpr int kFactor = 2;
    features = network.add({.name = "stage" + std::to_string(stage),
                            .inputs = {features},
                            .channels = kFactor * kFactor * width,
                            .activation = Activation::kPrelu});
    features = network.add({.kind = LayerKind::kPixelShuffle, .inputs = {features}, .factor = kFactor});
  }
  network.add({.name = "last", .inputs = {features}, .channels = ports.outputs, .zero = ports.detail});
  return network;
}

}  // namespace pleat::superres
