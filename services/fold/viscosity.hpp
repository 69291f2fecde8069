// What the simulation loses of the waves in a cloth, and the fold step's short steps do not: neighbours' relative
// motion dies out (docs/fold.md).
#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "common/base/simd.hpp"
#include "services/fold/rings.hpp"

namespace pleat::fold {

/// Diffusion of velocities over a mesh, dv/dt = nu laplace v, with the mean of a vertex's neighbours less its own for
/// a^2 / 4 laplace v, a the length of edges. A common motion stays, and so does a rotation where rings are regular.
class Viscosity {
 public:
  /// Of the rest mesh. At a border the neighbours on it alone count: a border that turns is not held back.
  explicit Viscosity(const Topology& mesh);

  /// Share of what a vertex lacks to its neighbours' mean that it gets within a time (s): 4 nu / a^2 times that, less
  /// where this would overshoot.
  float share(float time_s) const { return std::min(rate_ * time_s, kMost); }

  /// The mean of the neighbours' values (velocities) less the vertex's own; 0 without neighbours.
  Float4 lack(std::uint32_t vertex, std::span<const Float4> values) const {
    const std::span<const std::uint32_t> ring = rings_.of(vertex);
    if (ring.empty()) return Float4{};
    Float4 sum{};
    for (const std::uint32_t r : ring) sum += values[r];
    return weights_[vertex] * sum - values[vertex];
  }

 private:
  static constexpr float kMost = 0.9f;
  Rings rings_;
  std::vector<float> weights_;  // one over the number of neighbours
  float rate_ = 0;              // 1/s
};

}  // namespace pleat::fold
