// Draws a fine cloth to the coarse one by averages (docs/fold.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/fold/rings.hpp"
#include "services/fold/viscosity.hpp"

namespace pleat::fold {

/// The hat function of a coarse vertex over the fine vertices is their barycentric weight; averages over hats are by
/// mass.
class Tracking {
 public:
  /// masses: kg per fine vertex.
  Tracking(const Topology& coarse, const Subdivision& subdivision, std::span<const float> masses);

  /// What a fine vertex lacks in place (m) and in velocity (m/s), and the velocity that it has.
  struct Lack {
    Float4 place, velocity, moves;
  };

  /// Accelerations for at(), for a time (s). The averages of the places swing with `frequency` (rad/s), and what is
  /// common to many rings is drawn, critically damped, with another one of the method's; so is, harder, what touches an
  /// obstacle. The averages' relative motion is viscous. touching: per coarse vertex, 0 to 1. lack(i) gives a Lack.
  /// O(V_fine + V_coarse).
  template <typename Of>
  void update(const Of& lack, float frequency, float time_s, std::span<const float> touching) {
    begin();
    for (std::uint32_t i = 0; i < corners_.size(); ++i) {
      const Corners& c = corners_[i];
      const Lack l = lack(i);
      for (std::size_t k = 0; k < 3; ++k) {
        averages_[c.coarse[k]] += c.share[k] * l.place;
        large_[c.coarse[k]] += c.share[k] * l.velocity;
        moves_[c.coarse[k]] += c.share[k] * l.moves;
      }
    }
    finish(frequency, time_s, touching);
  }

  /// m/s^2, of a fine vertex.
  Float4 at(std::uint32_t i) const {
    const Corners& c = corners_[i];
    return c.weight[0] * averages_[c.coarse[0]] + c.weight[1] * averages_[c.coarse[1]] +
           c.weight[2] * averages_[c.coarse[2]];
  }

 private:
  void begin();
  void finish(float frequency, float time_s, std::span<const float> touching);

  // Of a fine vertex: coarse corners, their weights, and weights times mass over the mass of the corner's hat.
  struct Corners {
    std::array<std::uint32_t, 3> coarse;
    std::array<float, 3> weight, share;
  };
  std::vector<Corners> corners_;
  Rings rings_;  // of coarse vertices
  Viscosity viscosity_;
  std::vector<Float4> averages_, large_, moves_, smoothed_;  // per coarse vertex
};

}  // namespace pleat::fold
