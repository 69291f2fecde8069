#include "services/superres/networks/unet/unet.hpp"

#include <string>
#include <vector>

#include "services/superres/networks/parts.hpp"

namespace pleat::superres {

Description describe_unet(Options& options, const Ports& ports) {
  const int levels = options.integer("levels", 3, 0, 8), blocks = options.integer("blocks", 1, 1, 16);
  const int layers = options.integer("layers", 4, 1, 32), growth = options.integer("growth", 32, 1, 256);
  const int width = options.integer("features", 64, 1, 512);
  const std::string upsampling = read_upsampling(options);

  Description network(ports.inputs);
  const History history = add_history(network, options, ports);
  const int shallow = network.add({.name = "shallow0", .inputs = history.read, .channels = width, .exact = true});
  int features = network.add({.name = "shallow1", .inputs = {shallow}, .channels = width, .exact = true});
  const auto add_blocks = [&](const std::string& side, int level) {
    for (int b = 0; b < blocks; ++b) {
      const std::string name = side + std::to_string(level) + "_" + std::to_string(b);
      features = add_dense_block(network, name, features, layers, growth);
    }
  };
  std::vector<int> down;
  for (int level = 0; level < levels; ++level) {
    add_blocks("down", level);
    down.push_back(features);
    features = network.add({.kind = LayerKind::kPool, .inputs = {features}, .factor = 2});
  }
  add_blocks("down", levels);
  for (int level = levels - 1; level >= 0; --level) {
    const int beside = down[static_cast<std::size_t>(level)];
    const int enlarged = network.add({.kind = LayerKind::kResize, .inputs = {features}, .like = beside});
    features = network.add({.name = "join" + std::to_string(level),
                            .inputs = {beside, enlarged},
                            .channels = width,
                            .kernel = 1,
                            .add = beside});
    add_blocks("up", level);
  }
  features = network.add({.name = "global1", .inputs = {features}, .channels = width, .add = shallow});
  add_heads(network, features, upsampling, ports, history);
  return network;
}

}  // namespace pleat::superres
