// [MFSR] figure 13, the body of SRResNet as its successor EDSR left it, without normalisation by batches.
//   s = conv3(x), f = conv3(s); blocks f + conv3(relu(conv3(f))); g = conv3(f) + s; heads.
#pragma once

#include "services/superres/networks/options.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// Options: blocks 16, features 64, upsampling "bilinear" or "subpixel".
Description describe_srresnet(Options& options, const Ports& ports);

}  // namespace pleat::superres
