// How large a fine mesh gets, from numbers alone: services ask before they make anything of a mesh.
#pragma once

#include <cstdint>
#include <string>

namespace pleat {

/// Throws kResourceExhausted, with `field` before its message, if `rounds` subdivisions of a mesh with
/// `coarse_vertices` have more than `limit` vertices. Each round counts as four times as many; rounds beyond
/// kMaxSubdivisionRounds, which subdivide() refuses, as kMaxSubdivisionRounds.
void check_fine_size(std::int64_t coarse_vertices, int rounds, std::int64_t limit, const std::string& field);

}  // namespace pleat
