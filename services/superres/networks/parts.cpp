#include "services/superres/networks/parts.hpp"

#include <vector>

namespace pleat::superres {

int add_residual_blocks(Description& network, int features, int count) {
  const int channels = network.channels(features);
  for (int d = 0; d < count; ++d) {
    const std::string block = "block" + std::to_string(d);
    const int inner = network.add(
        {.name = block + "_first", .inputs = {features}, .channels = channels, .activation = Activation::kRelu});
    features = network.add({.name = block + "_second", .inputs = {inner}, .channels = channels, .add = features});
  }
  return features;
}

int add_dense_block(Description& network, const std::string& name, int features, int layers, int growth) {
  std::vector<int> dense{features};
  for (int c = 0; c < layers; ++c) {
    dense.push_back(network.add({.name = name + "_dense" + std::to_string(c),
                                 .inputs = dense,
                                 .channels = growth,
                                 .activation = Activation::kRelu}));
  }
  return network.add({.name = name + "_fusion",
                      .inputs = dense,
                      .channels = network.channels(features),
                      .kernel = 1,
                      .add = features});
}

std::string read_upsampling(Options& options) {
  return options.choice("upsampling", "bilinear", {"bilinear", "subpixel"});
}

int add_heads(Description& network, int features, const std::string& upsampling, const Ports& ports) {
  if (upsampling == "bilinear") {
    features = network.add({.kind = LayerKind::kUpsample, .inputs = {features}, .factor = ports.scale});
    return network.add({.name = "heads", .inputs = {features}, .channels = ports.outputs, .zero = ports.detail});
  }
  const int values = network.add({.name = "heads",
                                  .inputs = {features},
                                  .channels = ports.outputs * ports.scale * ports.scale,
                                  .zero = ports.detail});
  return network.add({.kind = LayerKind::kPixelShuffle, .inputs = {values}, .factor = ports.scale});
}

}  // namespace pleat::superres
