// Chen et al. 2018, [MFSR]'s reference [13]: residual blocks, sub-pixel stages of factor two, one convolution.
// It was made for positions alone: layout "positions".
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Options: blocks 16, features 64. As many stages as the scale has (two as published). Throws kInvalidArgument for a
/// scale that is no power of two.
Description describe_chen2018(Options& options, const Ports& ports);

}  // namespace pleat::superres
