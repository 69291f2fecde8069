// Animated obstacles of a scene file: point caches and HDF5 arrays.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// The first `most` samples (all, if there are fewer) of an animation, each (points x 3): `source` as open_points reads
/// it, for example body.pc2 or RESULT.h5:/obstacles/body/positions. Throws as it does, kInvalidArgument for another
/// number of points, kResourceExhausted beyond kMaxAnimationBytes.
std::vector<Positions> read_animation(const std::filesystem::path& source, Eigen::Index points, std::size_t most);

}  // namespace pleat::presentation
