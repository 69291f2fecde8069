// Draws a fine cloth to the coarse one by averages (docs/fold.md).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/simd.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/fold/lanes.hpp"
#include "services/fold/rings.hpp"
#include "services/fold/viscosity.hpp"

namespace pleat::fold {

/// The hat function of a coarse vertex over the fine vertices is their barycentric weight; averages over hats are by
/// mass.
class Tracking {
 public:
  /// masses: kg per fine vertex.
  Tracking(const Topology& coarse, const Subdivision& subdivision, std::span<const float> masses);

  /// What a fine vertex lacks in place (m) and in velocity (m/s), and the velocity that it has (for update()).
  struct Lack {
    Float4 place, velocity, moves;
  };

  /// Accelerations for at(), for a time (s). The averages of the places swing with `frequency` (rad/s), and what is
  /// common to many rings is drawn, critically damped, with another one of the method's. The averages' relative motion
  /// is viscous. lack(i) gives a Lack. O(V_fine + V_coarse).
  template <typename Of>
  void update(const Of& lack, float frequency, float time_s) {
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
    finish(frequency, time_s);
  }

  /// The averages of values of fine vertices, upsampled again: what of them is not finer than the coarse mesh.
  void smooth(std::span<const Float4> values, std::span<Float4> smoothed);

  /// m/s^2, of a fine vertex.
  Float4 at(std::uint32_t i) const {
    const Corners& c = corners_[i];
    return c.weight[0] * averages_[c.coarse[0]] + c.weight[1] * averages_[c.coarse[1]] +
           c.weight[2] * averages_[c.coarse[2]];
  }

  /// Which coarse vertices hold() holds, and how much of what they lack: per coarse vertex, 0 to 1.
  void set_touching(std::span<const float> touching);

  /// Moves the cloth at the end of a step (s) as springs, critically damped, between averages of what touches and their
  /// places would, hard along `down` (the direction of the weight, or 0) and softer across; implicitly, and so stable.
  /// lack(i) gives a Lack at the end. O(V_coarse + what touches).
  template <typename Of>
  void hold(const Of& lack, float step_s, Float4 down, std::span<Float4> x) {
    if (held_.empty()) return;
    std::fill(holds_.begin(), holds_.end(), Float4{});
    const auto spring = [step_s](float frequency, const Lack& l) {
      const float rate = frequency * step_s;
      return rate / ((1 + rate) * (1 + rate)) * (rate * l.place + 2 * step_s * l.velocity);
    };
    for (const std::uint32_t i : held_) {
      const Corners& c = corners_[i];
      const Lack l = lack(i);
      Float4 move = spring(kTouchFrequency, l);
      move += dot(down, spring(kWeightFrequency, l) - move) * down;
      for (std::size_t k = 0; k < 3; ++k) holds_[c.coarse[k]] += c.share[k] * move;
    }
    for (const std::uint32_t i : held_) {
      const Corners& c = corners_[i];
      for (std::size_t k = 0; k < 3; ++k) x[i] += c.weight[k] * touching_[c.coarse[k]] * holds_[c.coarse[k]];
    }
  }

 private:
  // rad/s. Where the coarse cloth lies on an obstacle it has met the friction. What touches carries what hangs from it,
  // ten times its own weight and more, and gives way by weight over mass and the square of the frequency. Held as hard
  // across, cloth on arms gets too many folds.
  static constexpr float kTouchFrequency = 40;
  static constexpr float kWeightFrequency = 200;

  void begin();
  void finish(float frequency, float time_s);

  // Of a fine vertex: coarse corners, their weights, and weights times mass over the mass of the corner's hat.
  struct Corners {
    std::array<std::uint32_t, 3> coarse;
    std::array<float, 3> weight, share;
  };
  std::vector<Corners> corners_;
  Rings rings_;  // of coarse vertices
  Viscosity viscosity_;
  std::vector<Float4> averages_, large_, moves_, smoothed_, holds_;  // per coarse vertex
  std::vector<float> touching_;                                      // per coarse vertex
  std::vector<std::uint32_t> held_;                                  // fine vertices
};

}  // namespace pleat::fold
