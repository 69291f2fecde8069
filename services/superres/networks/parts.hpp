// Parts that several networks share.
#pragma once

#include <string>

#include "services/superres/networks/description.hpp"
#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// `count` blocks f + conv3(relu(conv3(f))): "block<d>_first" and "_second". Returns the last value.
int add_residual_blocks(Description& network, int features, int count);

/// A residual dense block (RDN): `layers` times a_c = relu(conv3([f, a_1 .. a_c-1])) of `growth` features,
/// "<name>_dense<c>", then conv1([f, a_1 ..]) + f, "<name>_fusion". Returns the last value.
int add_dense_block(Description& network, const std::string& name, int features, int layers, int growth);

/// The option "upsampling" of networks that end in heads.
std::string read_upsampling(Options& options);

/// From features to the answer: one convolution for all outputs, which is the same as a head each for displacement,
/// normal and velocity. "bilinear" (published): features are upsampled before it. "subpixel": it answers with
/// scale^2 values a texel and output at the small size, which are then rearranged.
int add_heads(Description& network, int features, const std::string& upsampling, const Ports& ports);

}  // namespace pleat::superres
