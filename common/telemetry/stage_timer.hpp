// Time of a stage within a frame.
#pragma once

#include <chrono>

namespace pleat::telemetry {

/// Runs from construction on.
class StageTimer {
 public:
  double milliseconds() const {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start_).count();
  }
  /// The time since the start or the last lap, in milliseconds.
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double ms = std::chrono::duration<double, std::milli>(now - start_).count();
    start_ = now;
    return ms;
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace pleat::telemetry
