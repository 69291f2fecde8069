// Cloth simulation frame by frame: coarse alone, or with a fine mesh that tracks it or goes its own way.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

enum class Mode {
  kCoarse,       ///< the garment as it is
  kTrackedFine,  ///< the coarse garment, and the subdivided one that follows it (Scene::tracking)
  kFreeFine,     ///< both, untied
};

/// Milliseconds of one frame, summed over its steps.
struct SimulationTimes {
  double coarse_ms = 0;    ///< whole coarse simulation of the frame
  double fine_ms = 0;      ///< whole fine simulation of the frame
  double assembly_ms = 0;  ///< of the finest mesh simulated: forces and matrix
  double solve_ms = 0;     ///< linear solves
  double contact_ms = 0;   ///< proximity, continuous collision detection, impact zones
};

/// What happened in contact during the frame, both meshes together.
struct ContactReport {
  std::uint64_t contacts = 0;       ///< repulsions, summed over the steps
  std::uint64_t impacts = 0;        ///< impacts resolved
  std::uint64_t rigid_zones = 0;    ///< impact zones that had to be made rigid
  std::uint64_t cut_steps = 0;      ///< steps that had to be cut
  std::uint64_t yielded_steps = 0;  ///< steps in which a hard handle gave way
  std::uint64_t solver_iterations = 0;
  /// Of the coarse cloth, where steps had to be cut: vertices that had no room, the most in a step, and how far the
  /// obstacles are behind their script for it at the frame's end, metres.
  std::uint64_t pinched_vertices = 0;
  double obstacle_lag_m = 0;
};

struct SimulatedFrame {
  Frame coarse;
  std::optional<Frame> fine;  ///< kTrackedFine and kFreeFine
  std::vector<ObstacleFrame> obstacles;
  SimulationTimes times;
  ContactReport report;
  std::vector<std::string> warnings;  ///< what is doubtful in the scene, one line each, each once
};

/// A simulation from its first frame to its last. Deterministic: the same scene gives the same bits for any number of
/// threads. Every frame (as float32) is free of self-intersections and penetrations. Not thread-safe; several
/// simulations may run at once.
class Simulation {
 public:
  /// Validates the scene, and that the start is clean or, where the scene asks for it, can be relaxed until it is.
  /// Throws kInvalidArgument with the culprit. A tracked fine mesh starts from the coarse shape: not with Loop's rule.
  Simulation(Scene scene, Mode mode);
  ~Simulation();
  Simulation(Simulation&&) noexcept;
  Simulation& operator=(Simulation&&) noexcept;

  const Scene& scene() const;
  Mode mode() const;
  /// The garment (scaled by the scene's initial scale), and its subdivision by the scene's rule.
  const Topology& coarse() const;
  const Topology& fine() const;
  const Subdivision& subdivision() const;
  const std::vector<std::uint32_t>& feature_vertices() const;
  std::vector<ObstacleShape> obstacle_shapes() const;

  /// Index of the frame that next_frame() gives, from 0; scene().frames at the end.
  std::uint64_t next_index() const;

  /// next_frame() asks several times a step, from its own thread, and throws kCancelled when the answer is yes: only
  /// destruction makes sense after that.
  void stop_when(const std::function<bool()>& stopped);

  /// Simulates one frame. Frame 0 is the initial state. Throws kFailedPrecondition after the last frame.
  SimulatedFrame next_frame();

  /// The complete state after the last frame given: a simulation restored from it goes on bit-identically.
  std::vector<std::byte> checkpoint() const;
  /// Throws kDataLoss if the bytes are truncated or corrupt, kInvalidArgument if they belong to another scene or mode.
  void restore(std::span<const std::byte> checkpoint);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Where the scripts put the obstacles at a time.
std::vector<ObstacleFrame> obstacle_frames(const Scene& scene, double time_s);

}  // namespace pleat::simulation
