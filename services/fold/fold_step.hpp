// The fold step: a fine frame by physics that is held to the averages of the coarse cloth (docs/fold.md). Needs no
// training and no particular mesh.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/material.hpp"

namespace pleat::fold {

struct FoldOptions {
  simulation::Material material;            ///< of the cloth
  double frame_time_s = kDefaultFrameTime;  ///< between frames
  double frequency = 7;                     ///< rad/s, with which averages swing about the coarse cloth's; 0 to 50
  double step_s = 1.0 / 300;  ///< of the cloth; a frame is made in as many equal ones as are at most this long
  Eigen::Vector3d gravity{0, -9.81, 0};
  double air_density = 1;                                  ///< kg/m^3
  Eigen::Vector3d air_velocity = Eigen::Vector3d::Zero();  ///< m/s, of the wind
  double thickness_m = 3e-3;                               ///< kept between layers, where the coarse cloth has as much
  double clearance_m = 2e-3;                               ///< kept from obstacles
  double restart_m = 0.2;  ///< a state farther (RMS) from the coarse cloth of the frame before is not continued
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
  /// (V_fine x 3) optional: another answer for this frame, to which the fine cloth is drawn, and whose averages it
  /// follows in place of the coarse cloth's.
  const Positions* start = nullptr;
};

struct FoldReport {
  int steps = 0;
  std::size_t layer_contacts = 0, obstacle_contacts = 0;
  bool restarted = false;  ///< the state was missing, or did not fit: begun from the upsampled coarse cloth
  double ms = 0, contact_ms = 0;
};

/// One per stream: keeps constraints and memory, and no state. A result depends on the options and the arguments alone,
/// bit by bit. Not for several threads.
class FoldStep {
 public:
  /// subdivision: of `coarse`, with material coordinates. Throws kInvalidArgument for options out of range, a mesh
  /// without material coordinates, or unusable obstacles.
  FoldStep(const Topology& coarse, const Subdivision& subdivision, std::span<const ObstacleShape> obstacles,
           const FoldOptions& options);
  ~FoldStep();
  FoldStep(FoldStep&&) noexcept;
  FoldStep& operator=(FoldStep&&) noexcept;

  /// Replaces the state of the frame before by that of this one; its positions are the fine frame. O(V_fine steps).
  /// What lies in obstacles or through itself all the same is left to refinement. Throws kInvalidArgument for wrong
  /// sizes, indices, values that are not finite, or unusable obstacles; the state is then as it was.
  FoldReport fold(const FoldFrame& frame, FoldState& state);

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

}  // namespace pleat::fold
