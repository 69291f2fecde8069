// [MFSR] section 5.1, figure 4: residual dense blocks as in its reference [17] (RDN).
//   s = conv3(x), f = conv3(s); block d: `layers` times a_c = relu(conv3([f, a_1 .. a_c-1])) of `growth` features, then
//   f = conv1([f, a_1 ..]) + f; g = conv3(conv1([f_1 .. f_D])) + s; heads.
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Options: blocks 16, layers 6, growth 32, features 64 (the published sizes), upsampling "bilinear" or "subpixel",
/// history 0 (of its own last answers, History).
Description describe_mfsr(Options& options, const Ports& ports);

}  // namespace pleat::superres
