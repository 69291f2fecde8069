// Draws a fine cloth to the coarse one by averages (docs/fold.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::fold {

/// The hat function of a coarse vertex over the fine vertices is their barycentric weight; averages over hats are by
/// mass.
class Tracking {
 public:
  /// masses: kg per fine vertex.
  Tracking(const Topology& coarse, const Subdivision& subdivision, std::span<const float> masses);

  /// From what the fine vertices lack in place (m) and in velocity (m/s): accelerations for at(). The averages of the
  /// places swing with `frequency` (rad/s), and what is common to many rings is drawn, critically damped, with another
  /// one of the method's; so is, harder, what touches an obstacle. touching: per coarse vertex, 0 to 1. lack(i) gives
  /// both. O(V_fine + V_coarse).
  struct Lack {
    Float4 place, velocity;
  };
  template <typename Of>
  void update(const Of& lack, float frequency, std::span<const float> touching) {
    begin();
    for (std::uint32_t i = 0; i < corners_.size(); ++i) {
      const Corners& c = corners_[i];
      const Lack l = lack(i);
      for (std::size_t k = 0; k < 3; ++k) {
        averages_[c.coarse[k]] += c.share[k] * l.place;
        large_[c.coarse[k]] += c.share[k] * l.velocity;
      }
    }
    finish(frequency, touching);
  }

  /// m/s^2, of a fine vertex.
  Float4 at(std::uint32_t i) const {
    const Corners& c = corners_[i];
    return c.weight[0] * averages_[c.coarse[0]] + c.weight[1] * averages_[c.coarse[1]] +
           c.weight[2] * averages_[c.coarse[2]];
  }

 private:
  void begin();
  void finish(float frequency, std::span<const float> touching);

  // Of a fine vertex: coarse corners, their weights, and weights times mass over the mass of the corner's hat.
  struct Corners {
    std::array<std::uint32_t, 3> coarse;
    std::array<float, 3> weight, share;
  };
  std::vector<Corners> corners_;
  std::vector<std::uint32_t> ring_begin_, ring_;     // neighbours of coarse vertices
  std::vector<Float4> averages_, large_, smoothed_;  // per coarse vertex
};

}  // namespace pleat::fold
