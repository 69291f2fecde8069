// The network of [DT-S]: a vector of numbers a frame, and a transformer over them.
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Two autoencoders, of the coarse and of the fine mesh's vertex features, and a transformer between their codes:
///   convolution   y_i = W_p x_i + W_n mean_j x_j + b over the neighbours j of vertex i ([DT-S] eq. 5)
///   encoder       z = FC(conv(tanh(conv(f)))), `latent` numbers of all vertices
///   decoder       the same weights transposed, tanh after each convolution
///   transformer   each number of each frame is a token: coarse ones of frames t-T+1 .. t, and the network's own of
///                 t-T .. t-1; `blocks` with spatial attention (between a frame's numbers) and temporal attention
///                 (between a number's frames) side by side, then as many over the own tokens, to themselves and older
///                 ones, and to the coarse ones of both kinds; the last frame's tokens are what comes on top of z(t-1).
/// It remembers its codes of the last T frames. Options: latent, features of a token, heads, hidden, blocks, the
/// modules' switches spatial and temporal, norm ("none", or "layer": leaky ReLU and layer normalisation in place of
/// tanh in the encoders), output ("tanh", or "linear" for features that are not scaled to its range).
Description describe_published(Options& options, const Ports& ports);

}  // namespace pleat::superres
