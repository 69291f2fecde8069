// Waiting times between attempts to reach something.
#pragma once

#include <algorithm>
#include <chrono>
#include <random>

namespace pleat::coordinator {

/// Exponential with jitter: attempt k waits between half and all of min(first * 2^k, longest), so that many sessions
/// that lost the same service do not come back in one instant.
class Backoff {
 public:
  using Duration = std::chrono::milliseconds;

  explicit Backoff(Duration first = Duration(50), Duration longest = Duration(2000),
                   unsigned seed = std::random_device{}())
      : first_(first), longest_(longest), current_(first), random_(seed) {}

  Duration next() {
    const Duration whole = current_;
    current_ = std::min(current_ * 2, longest_);
    return whole / 2 + Duration(std::uniform_int_distribution<Duration::rep>(0, whole.count() / 2)(random_));
  }
  void reset() { current_ = first_; }

 private:
  Duration first_, longest_, current_;
  std::minstd_rand random_;
};

}  // namespace pleat::coordinator
