#include "services/superres/networks/parts.hpp"

#include <vector>

#include "common/base/error.hpp"

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

History add_history(Description& network, Options& options, const Ports& ports) {
  History history{.frames = options.integer("history", 0, 0, kMostHistory)};
  if (history.frames == 0) return history;
  const int given =
      network.add({.kind = LayerKind::kGiven, .inputs = {0}, .channels = ports.outputs, .factor = ports.scale});
  network.given_memory = network.add({.kind = LayerKind::kUnshuffle, .inputs = {given}, .factor = ports.scale});
  network.remembered = history.frames;
  history.recalled = network.add(
      {.kind = LayerKind::kMemory, .inputs = {0}, .channels = history.frames * network.channels(network.given_memory)});
  history.read.push_back(history.recalled);
  return history;
}

int add_heads(Description& network, int features, const std::string& upsampling, const Ports& ports,
              const History& history) {
  const int values_each = ports.scale * ports.scale;
  int values = -1;
  if (upsampling == "bilinear") {
    const int enlarged = network.add({.kind = LayerKind::kUpsample, .inputs = {features}, .factor = ports.scale});
    const int heads =
        network.add({.name = "heads", .inputs = {enlarged}, .channels = ports.outputs, .zero = ports.detail});
    if (history.frames == 0) return heads;
    values = network.add({.kind = LayerKind::kUnshuffle, .inputs = {heads}, .factor = ports.scale});
  } else {
    values = network.add(
        {.name = "heads", .inputs = {features}, .channels = ports.outputs * values_each, .zero = ports.detail});
  }
  if (history.frames > 0) {
    values = network.add({.name = "carried",
                          .inputs = {history.recalled},
                          .channels = ports.outputs * values_each,
                          .kernel = 1,
                          .add = values,
                          .exact = true,
                          .zero = true});
    network.memory = values;
  }
  return network.add({.kind = LayerKind::kPixelShuffle, .inputs = {values}, .factor = ports.scale});
}

AttentionSizes read_attention(Options& options, int frames) {
  AttentionSizes sizes;
  sizes.features = options.integer("features", sizes.features, 1, 1024);
  sizes.heads = options.integer("heads", sizes.heads, 1, 64);
  sizes.hidden = options.integer("hidden", sizes.hidden, 1, 4096);
  sizes.frames = frames;
  if (sizes.features % sizes.heads != 0) {
    throw_invalid_argument("architecture: features = " + std::to_string(sizes.features) + " do not fall into " +
                           std::to_string(sizes.heads) + " heads");
  }
  return sizes;
}

namespace {

/// A layer for each token.
int add_map(Description& network, const std::string& name, int tokens, int channels, const AttentionSizes& sizes,
            int add = -1, Activation activation = Activation::kNone) {
  return network.add({.name = name,
                      .inputs = {tokens},
                      .channels = sizes.frames * channels,
                      .kernel = 1,
                      .add = add,
                      .activation = activation,
                      .exact = true,
                      .frames = sizes.frames});
}

int add_norm(Description& network, const std::string& name, int tokens, const AttentionSizes& sizes, int add = -1) {
  return network.add(
      {.kind = LayerKind::kNorm, .name = name, .inputs = {tokens}, .add = add, .exact = true, .frames = sizes.frames});
}

int add_mix(Description& network, const std::string& name, int tokens, std::vector<int> read, bool over_frames,
            bool causal, const AttentionSizes& sizes, int add) {
  const int mixed = network.add({.kind = LayerKind::kAttention,
                                 .inputs = std::move(read),
                                 .frames = sizes.frames,
                                 .heads = sizes.heads,
                                 .over_frames = over_frames,
                                 .causal = causal});
  const int sum = add_map(network, name + "_mix", mixed, sizes.features, sizes, tokens);
  return add_norm(network, name + "_norm", sum, sizes, add);
}

}  // namespace

int add_attention(Description& network, const std::string& name, int tokens, bool over_frames, bool causal,
                  const AttentionSizes& sizes, int add) {
  const int parts = add_map(network, name + "_parts", tokens, 3 * sizes.features, sizes);
  return add_mix(network, name, tokens, {parts}, over_frames, causal, sizes, add);
}

int add_cross_attention(Description& network, const std::string& name, int tokens, int others, bool over_frames,
                        const AttentionSizes& sizes, int add) {
  const int queries = add_map(network, name + "_queries", tokens, sizes.features, sizes);
  const int read = add_map(network, name + "_others", others, 2 * sizes.features, sizes);
  return add_mix(network, name, tokens, {queries, read}, over_frames, false, sizes, add);
}

int add_perceptron(Description& network, const std::string& name, int tokens, const AttentionSizes& sizes) {
  const int hidden = add_map(network, name + "_hidden", tokens, sizes.hidden, sizes, -1, Activation::kRelu);
  const int sum = add_map(network, name + "_out", hidden, sizes.features, sizes, tokens);
  return add_norm(network, name + "_norm", sum, sizes);
}

int add_attention_block(Description& network, const std::string& name, int tokens, bool spatial, bool temporal,
                        const AttentionSizes& sizes) {
  int seen = -1;
  if (spatial) seen = add_attention(network, name + "_spatial", tokens, false, false, sizes, seen);
  if (temporal) seen = add_attention(network, name + "_temporal", tokens, true, false, sizes, seen);
  return add_perceptron(network, name, seen < 0 ? tokens : seen, sizes);
}

}  // namespace pleat::superres
