#include "services/superres/networks/chen2018/chen2018.hpp"

#include "common/base/error.hpp"
#include "services/superres/networks/parts.hpp"

namespace pleat::superres {

Description describe_chen2018(Options& options, const Ports& ports) {
  const int blocks = options.integer("blocks", 16, 1, 64), width = options.integer("features", 64, 1, 512);
  if (ports.scale != 4) throw_invalid_argument("architecture: kind 'chen2018' has two stages of factor two, scale 4");

  Description network(ports.inputs);
  const int shallow = network.add(
      {.name = "shallow0", .inputs = {0}, .channels = width, .activation = Activation::kPrelu, .exact = true});
  int features = add_residual_blocks(network, shallow, blocks);
  features = network.add({.name = "global1", .inputs = {features}, .channels = width, .add = shallow});
  for (const char* stage : {"stage0", "stage1"}) {
    // The paper's slopes, one a channel, come after the shuffle; here each of a channel's four texels has one.
    features =
        network.add({.name = stage, .inputs = {features}, .channels = 4 * width, .activation = Activation::kPrelu});
    features = network.add({.kind = LayerKind::kPixelShuffle, .inputs = {features}, .factor = 2});
  }
  network.add({.name = "last", .inputs = {features}, .channels = ports.outputs, .zero = ports.detail});
  return network;
}

}  // namespace pleat::superres
