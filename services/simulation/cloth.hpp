// One simulated mesh: its state, and one time step of it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/contact.hpp"
#include "services/simulation/dynamics.hpp"
#include "services/simulation/scene.hpp"
#include "services/simulation/strain_limits.hpp"
#include "services/simulation/untangle.hpp"

namespace pleat::simulation {

/// A handle's vertices on a certain mesh, and where they were when it took hold.
struct HandleState {
  std::vector<std::uint32_t> vertices;
  bool active = false;
  std::vector<Eigen::Vector3d> anchors;
  Eigen::Vector3d pivot = Eigen::Vector3d::Zero();
};

/// Sums over the steps since take_report().
struct ClothReport {
  std::uint64_t contacts = 0, impacts = 0, rigid_zones = 0, cut_steps = 0, yielded_steps = 0, solver_iterations = 0;
  std::uint64_t stopped_vertices = 0;  ///< the most in one of the cut steps
  double total_ms = 0, assembly_ms = 0, solve_ms = 0, contact_ms = 0;
};

/// What a step is held to besides its handles, at its end.
struct Following {
  std::span<const Pin> springs = {};
  double frequency = 0;                           ///< rad/s: of averages, to those of the targets
  std::span<const Eigen::Vector3d> targets = {};  ///< (V) m; read if there is a frequency
};

/// `scene` must outlive it.
class Cloth {
 public:
  /// mesh: rest shape; initial: (V) positions at time 0; handle_vertices: per handle of the scene, indices in mesh.
  /// The last two add the second level of a tracked simulation.
  Cloth(const Topology& mesh, Points initial, std::vector<std::vector<std::uint32_t>> handle_vertices,
        const Scene& scene, const Topology* coarse = nullptr, std::span<const std::uint32_t> feature_vertices = {});

  /// Tells how the mesh was subdivided: the linear solver uses the levels.
  void use_levels(const Subdivision& subdivision) { dynamics_.use_levels(subdivision); }

  /// Lets steps follow averages.
  void track_averages(const Subdivision& subdivision, const Faces& coarse_faces) {
    dynamics_.track_averages(subdivision, coarse_faces);
  }

  /// Throws kInvalidArgument unless the initial state is clean.
  void check_start(ThreadPool& pool);

  /// Before the first step: relaxes an initial state that is not clean, as far as it goes (untangle.hpp).
  void untangle(ThreadPool& pool) { simulation::untangle(contact_, positions_, pool); }

  /// Advances from `time_s` by one step. A step that turns out too large for the forces is made in halves, and counted
  /// as cut; kFailedPrecondition if even the smallest ones diverge.
  void step(double time_s, double step_s, const Following& following, ThreadPool& pool);

  /// step() asks now and then, and throws kCancelled when the answer is yes. The state is of no use after that.
  void stop_when(const std::function<bool()>& stopped) {
    stopped_ = stopped;
    contact_.stop_when(stopped);
  }

  std::size_t vertex_count() const { return dynamics_.vertex_count(); }
  /// All collision particles: the cloth's vertices first, then the obstacles (ContactSystem).
  const Points& particles() const { return positions_; }
  std::span<const Eigen::Vector3d> positions() const { return std::span(positions_).first(vertex_count()); }
  const ContactSystem& contact() const { return contact_; }
  const Dynamics& dynamics() const { return dynamics_; }
  ClothReport take_report();
  /// Metres by which the hard handle's vertices lag behind its script at most, at a time. 0 unless it is active.
  double handle_lag(std::size_t handle, double time_s) const;
  /// Metres by which a point of an obstacle is behind its script at most, at a time.
  double obstacle_lag(double time_s) const;

  /// The state that a step changes, for check-points.
  template <typename Archive>
  void archive(Archive& archive) {
    archive.vectors(positions_);
    archive.vectors(velocities_);
    archive.floats(dynamics_.reference_angles());
    archive.registers(dynamics_.last_change());
    for (HandleState& handle : handles_) {
      archive.flag(handle.active);
      archive.vectors(handle.anchors);
      archive.vector(handle.pivot);
    }
  }

 private:
  std::span<const Eigen::Vector3d> obstacle_targets(double time_s, double step_s);
  void collect_pins(double time_s, double step_s);
  void advance(double time_s, double step_s, const Following& following, ThreadPool& pool, int halvings);

  const Scene& scene_;
  std::function<bool()> stopped_;
  Dynamics dynamics_;
  ContactSystem contact_;
  StrainLimits strain_limits_;
  Points positions_, velocities_;  // of all particles
  // Buffers of a step: its end, the velocities of the cloth's vertices that it began with, and the obstacles at its
  // end, where the script has them and where they get if that is another place.
  Points end_, velocities_before_, scripted_, scripted_next_, targets_;
  double scripted_time_s_ = -1;  // of scripted_
  std::vector<HandleState> handles_;
  std::vector<Pin> pins_;
  std::vector<double> inverse_masses_, free_inverse_masses_;  // with and without the hard handles
  ClothReport report_;
};

}  // namespace pleat::simulation
