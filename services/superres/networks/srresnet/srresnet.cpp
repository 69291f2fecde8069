#include "services/superres/networks/srresnet/srresnet.hpp"

#include "services/superres/networks/parts.hpp"

namespace pleat::superres {

Description describe_srresnet(Options& options, const Ports& ports) {
  const int blocks = options.integer("blocks", 16, 1, 64), width = options.integer("features", 64, 1, 512);
  const std::string upsampling = read_upsampling(options);

  Description network(ports.inputs);
  const int shallow = network.add({.name = "shallow0", .inputs = {0}, .channels = width, .exact = true});
  int features = network.add({.name = "shallow1", .inputs = {shallow}, .channels = width, .exact = true});
  features = add_residual_blocks(network, features, blocks);
  features = network.add({.name = "global1", .inputs = {features}, .channels = width, .add = shallow});
  add_heads(network, features, upsampling, ports);
  return network;
}

}  // namespace pleat::superres
