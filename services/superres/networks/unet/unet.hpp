// Residual dense blocks as [MFSR]'s, at several scales: a fold depends on what the cloth does far away, and at an
// eighth of the size a 3 x 3 kernel sees eight times as far. The shape is that of Ronneberger et al. 2015 (U-Net).
//   s = conv3(x), f = conv3(s); down: f_l = blocks(f), f = mean of f_l over 2 x 2; at the bottom f = blocks(f);
//   up: f = blocks(conv1([f_l, enlarged f]) + f_l); g = conv3(f) + s; heads.
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Options: levels 3 (times that the size is halved), blocks 1 (at each level, down and up), layers 4, growth 32,
/// features 64, upsampling "bilinear" or "subpixel", history 0 (of its own last
/// answers, History).
Description describe_unet(Options& options, const Ports& ports);

}  // namespace pleat::superres
