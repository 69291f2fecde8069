// Velocities of frames that come without them.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/features/frame_features.hpp"

namespace pleat::coordinator {

/// Backward differences over the time between frames; zero where no earlier frame is known. A frame that is sent again
/// gets the velocities that it had, and a gap (a frame that was refused) counts with its whole time. Not thread-safe.
class VelocityFiller {
 public:
  /// frame_time_s > 0, between frames with consecutive indices.
  explicit VelocityFiller(double frame_time_s) : frame_time_s_(frame_time_s) {}

  /// positions: (3V) metres. Returns (3V) m/s. Remembers the frame.
  std::vector<float> fill(std::uint64_t index, const float* positions, std::size_t count) {
    const Known* before = nullptr;
    for (const Known& known : known_) {
      if (known.valid && known.index < index && known.positions.size() == count &&
          (before == nullptr || known.index > before->index)) {
        before = &known;
      }
    }
    std::vector<float> velocities(count);
    const std::uint64_t frames = before != nullptr ? index - before->index : 1;
    backward_velocities({positions, count},
                        before != nullptr ? std::span<const float>(before->positions) : std::span<const float>(),
                        frame_time_s_ * static_cast<double>(frames), velocities);
    remember(index, positions, count);
    return velocities;
  }

 private:
  struct Known {
    bool valid = false;
    std::uint64_t index = 0;
    std::vector<float> positions;
  };

  void remember(std::uint64_t index, const float* positions, std::size_t count) {
    Known* place = nullptr;
    for (Known& known : known_) {
      if (known.valid && known.index == index) place = &known;
    }
    if (place == nullptr) {
      // The older one goes; an empty one is the oldest.
      place = !known_[0].valid || (known_[1].valid && known_[0].index < known_[1].index) ? &known_[0] : &known_[1];
    }
    place->valid = true;
    place->index = index;
    place->positions.assign(positions, positions + count);
  }

  const double frame_time_s_;
  std::array<Known, 2> known_;  ///< two, so that the newest frame can be sent again
};

}  // namespace pleat::coordinator
