// Animated obstacles of a scene file: point caches and HDF5 arrays.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::presentation {

/// The samples of an animation, each (points x 3). `source` is
///   FILE.pc2               a point cache
///   FILE.h5                its array `positions` (T, points, 3), of any floating type
///   FILE.h5:/group/array   another array of that shape, for example RESULT.h5:/obstacles/body/positions
/// Throws kNotFound (no such file), kInvalidArgument (no such array, another number of points, values that are not
/// finite: the sample is named), kDataLoss (truncated), kResourceExhausted (more than a message can take).
std::vector<Positions> read_animation(const std::filesystem::path& source, Eigen::Index points);

}  // namespace pleat::presentation
