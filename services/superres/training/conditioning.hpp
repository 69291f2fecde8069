// The constants of a conditioned network. Inside services/superres only: this header needs LibTorch.
#pragma once

#include "services/superres/network.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// Measured on up to 256 frames of the training sequences.
Conditioning measure_conditioning(const PairData& data, const Architecture& architecture);

}  // namespace pleat::superres
