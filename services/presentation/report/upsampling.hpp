// The plain upsampling that enhanced frames are compared with.
#pragma once

#include <optional>

#include "common/mesh/subdivision.hpp"

namespace pleat::presentation {

/// The subdivision that leads from `coarse` to `fine`, or nothing if the fine mesh was made in another way (then there
/// is no vertex-to-vertex comparison with the upsampled coarse mesh). Tries up to four rounds. O(F_fine).
std::optional<Subdivision> find_upsampling(const Topology& coarse, const Topology& fine);

}  // namespace pleat::presentation
