#include "services/superres/networks/mfsr/mfsr.hpp"

#include "services/superres/networks/parts.hpp"

namespace pleat::superres {

Description describe_mfsr(Options& options, const Ports& ports) {
  const int blocks = options.integer("blocks", 16, 1, 64), layers = options.integer("layers", 6, 1, 32);
  const int growth = options.integer("growth", 32, 1, 256), width = options.integer("features", 64, 1, 512);
  const std::string upsampling = read_upsampling(options);

  Description network(ports.inputs);
  const History history = add_history(network, options, ports);
  const int shallow = network.add({.name = "shallow0", .inputs = history.read, .channels = width, .exact = true});
  int features = network.add({.name = "shallow1", .inputs = {shallow}, .channels = width, .exact = true});
  std::vector<int> hierarchy;
  for (int d = 0; d < blocks; ++d) {
    features = add_dense_block(network, "block" + std::to_string(d), features, layers, growth);
    hierarchy.push_back(features);
  }
  features = network.add({.name = "global0", .inputs = hierarchy, .channels = width, .kernel = 1});
  features = network.add({.name = "global1", .inputs = {features}, .channels = width, .add = shallow});
  add_heads(network, features, upsampling, ports, history);
  return network;
}

}  // namespace pleat::superres
