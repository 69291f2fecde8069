// A token for every place and frame, which look at one another.
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Blocks of spatial attention (between the places of a frame) and temporal attention (between the frames of a place)
/// side by side, as the spatial-temporal transformer of [ST]; then one perceptron for all places, which answers
/// scale^2 values a channel for each. Options: features of a token, heads, blocks, hidden (width of the perceptrons),
/// and the modules' switches, spatial and temporal. history: of so many of its own last answers the first three
/// channels are read beside the input and added to the answer through a linear map (which begins at zero): what three
/// coarse frames do not tell, for example how fast the fine cloth moves. inertia: that map reads the input, too: where
/// the fine cloth would fly without forces is linear in its last two places and those of the coarse one, so that only
/// what acts on it is left to the rest of the network.
Description describe_tokens(Options& options, const Ports& ports);

}  // namespace pleat::superres
