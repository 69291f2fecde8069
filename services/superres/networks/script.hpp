// A network's layers as TorchScript.
#pragma once

#include <string>

#include "services/superres/networks/description.hpp"

namespace pleat::superres {

/// The text of `forward(self, x)`: reads self.NAME_weight, _bias and _slope. The type of a layer is that of its weight,
/// so that one module serves float32 and bfloat16.
std::string script_of(const Description& network);

}  // namespace pleat::superres
