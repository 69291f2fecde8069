// A network's layers as TorchScript.
#pragma once

#include <string>

#include "services/superres/networks/description.hpp"

namespace pleat::superres {

/// The text of `forward(self, x)`, which returns the answer, or of `forward(self, x, memory)` where the network
/// remembers: the answer, and what is remembered after it. Reads self.NAME_weight, _bias, _slope and _time, and of
/// means NAME_places and NAME_shares. The type of a layer is that of its weight, so that one module serves float32 and
/// bfloat16. Layers that only training needs are left out.
std::string script_of(const Description& network);

}  // namespace pleat::superres
