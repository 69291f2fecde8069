// Parts that several networks share.
#pragma once

#include <string>
#include <vector>

#include "services/superres/networks/description.hpp"
#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// `count` blocks f + conv3(relu(conv3(f))): "block<d>_first" and "_second". Returns the last value.
int add_residual_blocks(Description& network, int features, int count);

/// A residual dense block (RDN): `layers` times a_c = relu(conv3([f, a_1 .. a_c-1])) of `growth` features,
/// "<name>_dense<c>", then conv1([f, a_1 ..]) + f, "<name>_fusion". Returns the last value.
int add_dense_block(Description& network, const std::string& name, int features, int layers, int growth);

/// Frames that a network may remember at most.
inline constexpr int kMostHistory = 4;

/// The option "history" of networks of images: of so many of its own last answers, made as small as the input, the
/// network reads all values beside it. What one coarse frame does not tell is which way the cloth has buckled.
struct History {
  int frames = 0;     ///< 0: none
  int recalled = -1;  ///< what is remembered
  std::vector<int> read = {0};
};
History add_history(Description& network, Options& options, const Ports& ports);

/// The option "upsampling" of networks that end in heads.
std::string read_upsampling(Options& options);

/// From features to the answer: one convolution for all outputs, which is the same as a head each for displacement,
/// normal and velocity. "bilinear" (published): features are upsampled before it. "subpixel": it answers with
/// scale^2 values a texel and output at the small size, which are then rearranged. With a history a linear map of it,
/// which begins at zero, is added, and the answer is what the network remembers.
int add_heads(Description& network, int features, const std::string& upsampling, const Ports& ports,
              const History& history = {});

/// Of a block of attention over tokens, which lie in `frames` parts of `features` channels at each place.
struct AttentionSizes {
  int features = 64, heads = 8, hidden = 256, frames = 1;
};

/// Reads "features", "heads" and "hidden". Throws kInvalidArgument unless the features fall into heads.
AttentionSizes read_attention(Options& options, int frames);

/// What tokens learn from one another, added to them and normalised: "<name>_parts", "_mix" and "_norm". `add` comes on
/// top of that; -1: nothing.
int add_attention(Description& network, const std::string& name, int tokens, bool over_frames, bool causal,
                  const AttentionSizes& sizes, int add);
/// The same from other tokens: "<name>_queries", "_others", "_mix" and "_norm".
int add_cross_attention(Description& network, const std::string& name, int tokens, int others, bool over_frames,
                        const AttentionSizes& sizes, int add);
/// A perceptron for each token, added to it and normalised: "<name>_hidden", "_out" and "_norm".
int add_perceptron(Description& network, const std::string& name, int tokens, const AttentionSizes& sizes);

/// A block of [ST]: spatial attention (between the places of a frame) and temporal attention (between the frames of a
/// place) side by side, summed, then a perceptron.
int add_attention_block(Description& network, const std::string& name, int tokens, bool spatial, bool temporal,
                        const AttentionSizes& sizes);

}  // namespace pleat::superres
