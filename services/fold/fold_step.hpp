// The fold step: a fine frame by physics, one implicit step a frame held to the averages of the coarse cloth
// (docs/fold.md). Needs no training and no particular mesh.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/material.hpp"

namespace pleat::fold {

struct FoldOptions {
  simulation::Material material;  ///< of the cloth
  double frame_time_s = 0.04;     ///< between frames; above 0
  double frequency = 9;           ///< rad/s, with which averages swing about the coarse cloth's; frame_time_s times it
                                  ///< is 0 to 10
  Eigen::Vector3d gravity{0, -9.81, 0};
  double thickness_m = 5e-3;    ///< kept between layers; at most a quarter of the mean fine edge is used
  double clearance_m = 2e-3;    ///< kept from obstacles
  int most_steps = 4;           ///< in a frame; quick motion is made in several
  double step_motion_m = 0.03;  ///< a step for every so much that the coarse cloth departs from its inertia in a frame
  double tolerance = 0.03;      ///< of the linear solver, relative
  int most_iterations = 40;
  double restart_m = 0.2;  ///< a state whose averages are farther (RMS) from the coarse cloth is not continued
  int threads = 0;         ///< 0: the processors this process may use; the result does not depend on it
};

/// What a frame leaves for the next one: the fine cloth, (V_fine x 3) each. Empty: there is none.
struct FoldState {
  Positions positions, velocities;  ///< m, m/s
};

/// A frame's input. References live as long as the call.
struct FoldFrame {
  const Positions& coarse;             ///< (V_coarse x 3)
  const Positions& coarse_velocities;  ///< (V_coarse x 3), backward differences over a frame
  std::span<const ObstacleFrame> obstacles = {};
  std::span<const std::uint32_t> held = {};  ///< coarse vertices in handles: the fine cloth is there exactly
  const Positions* start = nullptr;          ///< (V_fine x 3) optional: where the solution is looked for, instead of
                                             ///< where the state goes with the coarse cloth
};

struct FoldReport {
  int steps = 0, iterations = 0;
  std::size_t contacts = 0;
  bool restarted = false;  ///< the state was missing, or did not fit: begun from the upsampled coarse cloth
  bool gave_up = false;    ///< the step diverged: the result is the upsampled coarse cloth
  double ms = 0, assembly_ms = 0, solve_ms = 0, contact_ms = 0;
};

/// One per stream: keeps patterns and memory, and no state. A result depends on the options and the arguments alone,
/// bit by bit, for any number of threads. Not for several threads.
class FoldStep {
 public:
  /// subdivision: of `coarse`, with material coordinates. Throws kInvalidArgument for options out of range, a mesh
  /// without material coordinates, or unusable obstacles.
  FoldStep(const Topology& coarse, const Subdivision& subdivision, std::span<const ObstacleShape> obstacles,
           const FoldOptions& options);
  ~FoldStep();
  FoldStep(FoldStep&&) noexcept;
  FoldStep& operator=(FoldStep&&) noexcept;

  /// Replaces the state of the frame before by that of this one; its positions are the fine frame. What lies in
  /// obstacles or through itself is left to refinement. Throws kInvalidArgument for wrong sizes, indices, values that
  /// are not finite, or unusable obstacles; the state is then as it was.
  FoldReport fold(const FoldFrame& frame, FoldState& state);

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

}  // namespace pleat::fold
