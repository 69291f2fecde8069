#include "services/superres/networks/tokens/tokens.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include "services/superres/networks/parts.hpp"

namespace pleat::superres {
namespace {

constexpr int kRememberedChannels = 3;  ///< the first ones of an answer: offsets

/// The values of an answer's first channels that mean something, out of one (channels scale^2, h, w).
int add_offsets(Description& network, int values, const Ports& ports) {
  const int all = ports.scale * ports.scale, block = ports.block > 0 ? ports.block : all;
  std::vector<int> parts;
  for (int c = 0; c < std::min(kRememberedChannels, ports.outputs); ++c) {
    parts.push_back(network.add({.kind = LayerKind::kPart, .inputs = {values}, .channels = block, .first = c * all}));
  }
  return network.add({.kind = LayerKind::kJoin, .inputs = parts});
}

}  // namespace

Description describe_tokens(Options& options, const Ports& ports) {
  const AttentionSizes sizes = read_attention(options, ports.window);
  const int blocks = options.integer("blocks", 2, 0, 32);
  const bool spatial = options.flag("spatial", true), temporal = options.flag("temporal", true);
  const int history = options.integer("history", 0, 0, kMostHistory), values_each = ports.scale * ports.scale;
  const bool inertia = options.flag("inertia", false);
  Description network(ports.inputs);
  std::vector<int> read{0};
  int recalled = -1;
  if (history > 0) {
    const int given =
        network.add({.kind = LayerKind::kGiven, .inputs = {0}, .channels = ports.outputs, .factor = ports.scale});
    const int blockwise = network.add({.kind = LayerKind::kUnshuffle, .inputs = {given}, .factor = ports.scale});
    network.given_memory = add_offsets(network, blockwise, ports);
    network.remembered = history;
    recalled = network.add(
        {.kind = LayerKind::kMemory, .inputs = {0}, .channels = history * network.channels(network.given_memory)});
    read.push_back(recalled);
  }
  int tokens = network.add(
      {.name = "tokens", .inputs = read, .channels = ports.window * sizes.features, .kernel = 1, .exact = true});
  for (int b = 0; b < blocks; ++b) {
    tokens = add_attention_block(network, "block" + std::to_string(b), tokens, spatial, temporal, sizes);
  }
  read.insert(read.begin(), tokens);
  const int hidden = network.add({.name = "answer_hidden",
                                  .inputs = read,
                                  .channels = sizes.hidden,
                                  .kernel = 1,
                                  .activation = Activation::kRelu,
                                  .exact = true});
  int carried = -1;
  if (history > 0) {
    carried = network.add({.name = "answer_carried",
                           .inputs = inertia ? std::vector{recalled, 0} : std::vector{recalled},
                           .channels = ports.outputs * values_each,
                           .kernel = 1,
                           .exact = true,
                           .zero = true});
  }
  const int values = network.add({.name = "answer",
                                  .inputs = {hidden},
                                  .channels = ports.outputs * values_each,
                                  .kernel = 1,
                                  .add = carried,
                                  .exact = true,
                                  .zero = ports.detail});
  if (history > 0) network.memory = add_offsets(network, values, ports);
  network.add({.kind = LayerKind::kPixelShuffle, .inputs = {values}, .factor = ports.scale});
  return network;
}

}  // namespace pleat::superres
