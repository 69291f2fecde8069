// Random choices of scenes. Internal to this room.
#pragma once

#include <cstdint>
#include <random>

#include "common/base/random.hpp"

namespace pleat::dataset {

/// Equal on every platform, unlike the standard distributions.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double low, double high) { return low + (high - low) * unit_interval(engine_()); }
  std::size_t below(std::size_t count) { return static_cast<std::size_t>(uniform(0, static_cast<double>(count))); }

 private:
  std::mt19937_64 engine_;
};

}  // namespace pleat::dataset
