// Seeded random numbers that are the same everywhere, unlike the standard library's distributions.
#pragma once

#include <cstdint>
#include <initializer_list>

namespace pleat {

/// splitmix64 (Steele, Lea, Flood 2014): a step and its mix. Advances `state`.
inline std::uint64_t split_mix(std::uint64_t& state) {
  state += 0x9E3779B97F4A7C15ull;
  std::uint64_t z = state;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

/// In [0, 1), from the upper 53 bits.
inline double unit_interval(std::uint64_t bits) { return static_cast<double>(bits >> 11) * 0x1p-53; }

}  // namespace pleat
