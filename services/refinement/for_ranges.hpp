// Loops over ranges on a pool that may be absent. Internal to this room.
#pragma once

#include <functional>

#include "common/base/parallel.hpp"

namespace pleat::refinement {

/// body(begin, end) over disjoint ranges of [0, count), at most `grain` long; the ranges do not depend on the pool.
/// Does not allocate.
template <typename Body>
void for_ranges(ThreadPool* pool, std::size_t count, std::size_t grain, const Body& body) {
  if (pool == nullptr || count <= grain) {
    for (std::size_t begin = 0; begin < count; begin += grain) body(begin, std::min(begin + grain, count));
    return;
  }
  pool->parallel_for(count, grain, std::cref(body));
}

}  // namespace pleat::refinement
