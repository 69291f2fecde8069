#include "services/superres/networks/tokens/tokens.hpp"

#include <string>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

struct Sizes {
  int features, heads, hidden, window;
};

/// What the tokens learn from one another, added to them, normalised; `add` comes on top of that.
int add_attention(Description& network, const std::string& name, int tokens, bool over_frames, const Sizes& sizes,
                  int add) {
  const int all = sizes.window * sizes.features;
  const int parts = network.add({.name = name + "_parts",
                                 .inputs = {tokens},
                                 .channels = 3 * all,
                                 .kernel = 1,
                                 .exact = true,
                                 .frames = sizes.window});
  const int mixed = network.add({.kind = LayerKind::kAttention,
                                 .inputs = {parts},
                                 .frames = sizes.window,
                                 .heads = sizes.heads,
                                 .over_frames = over_frames});
  const int sum = network.add({.name = name + "_mix",
                               .inputs = {mixed},
                               .channels = all,
                               .kernel = 1,
                               .add = tokens,
                               .exact = true,
                               .frames = sizes.window});
  return network.add({.kind = LayerKind::kNorm,
                      .name = name + "_norm",
                      .inputs = {sum},
                      .add = add,
                      .exact = true,
                      .frames = sizes.window});
}

int add_block(Description& network, const std::string& name, int tokens, bool spatial, bool temporal,
              const Sizes& sizes) {
  int seen = -1;
  if (spatial) seen = add_attention(network, name + "_spatial", tokens, false, sizes, seen);
  if (temporal) seen = add_attention(network, name + "_temporal", tokens, true, sizes, seen);
  if (seen < 0) seen = tokens;
  const int hidden = network.add({.name = name + "_hidden",
                                  .inputs = {seen},
                                  .channels = sizes.window * sizes.hidden,
                                  .kernel = 1,
                                  .activation = Activation::kRelu,
                                  .exact = true,
                                  .frames = sizes.window});
  const int sum = network.add({.name = name + "_out",
                               .inputs = {hidden},
                               .channels = sizes.window * sizes.features,
                               .kernel = 1,
                               .add = seen,
                               .exact = true,
                               .frames = sizes.window});
  return network.add(
      {.kind = LayerKind::kNorm, .name = name + "_norm", .inputs = {sum}, .exact = true, .frames = sizes.window});
}

}  // namespace

Description describe_tokens(Options& options, const Ports& ports) {
  Sizes sizes{};
  sizes.features = options.integer("features", 64, 1, 1024);
  sizes.heads = options.integer("heads", 8, 1, 64);
  sizes.hidden = options.integer("hidden", 256, 1, 4096);
  sizes.window = ports.window;
  const int blocks = options.integer("blocks", 2, 0, 32);
  const bool spatial = options.flag("spatial", true), temporal = options.flag("temporal", true);
  if (sizes.features % sizes.heads != 0) {
    throw_invalid_argument("architecture: features = " + std::to_string(sizes.features) + " do not fall into " +
                           std::to_string(sizes.heads) + " heads");
  }
  Description network(ports.inputs);
  int tokens = network.add(
      {.name = "tokens", .inputs = {0}, .channels = sizes.window * sizes.features, .kernel = 1, .exact = true});
  for (int b = 0; b < blocks; ++b) {
    tokens = add_block(network, "block" + std::to_string(b), tokens, spatial, temporal, sizes);
  }
  const int hidden = network.add({.name = "answer_hidden",
                                  .inputs = {tokens, 0},
                                  .channels = sizes.hidden,
                                  .kernel = 1,
                                  .activation = Activation::kRelu,
                                  .exact = true});
  const int values = network.add({.name = "answer",
                                  .inputs = {hidden},
                                  .channels = ports.outputs * ports.scale * ports.scale,
                                  .kernel = 1,
                                  .exact = true,
                                  .zero = ports.detail});
  network.add({.kind = LayerKind::kPixelShuffle, .inputs = {values}, .factor = ports.scale});
  return network;
}

}  // namespace pleat::superres
