// What the rivals of the engine's solver share: the engine's energies, masses, air and contact around a solver of their
// own. For measurements: one cloth without obstacles, damping and wind, held by soft handles that do not move.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/base/simd.hpp"
#include "services/simulation/contact.hpp"
#include "services/simulation/elements.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::bench {

struct RivalFace {
  std::array<std::uint32_t, 3> v;
  simulation::TriangleRest<float> rest;
};
struct RivalHinge {
  std::array<std::uint32_t, 4> v;
  simulation::HingeRest<float> rest;
};
/// A spring between a vertex and where it began.
struct RivalPin {
  std::uint32_t vertex;
  Double4 target;
  float stiffness;  ///< N/m
};

/// Solvers derive from it. `scene` must outlive it.
class RivalCloth {
 public:
  /// garment: rest shape; start: (V x 3) positions at time 0. Throws kInvalidArgument for a scene outside of the above.
  RivalCloth(const simulation::Scene& scene, const Topology& garment, const Positions& start);
  virtual ~RivalCloth() = default;
  RivalCloth(const RivalCloth&) = delete;
  RivalCloth& operator=(const RivalCloth&) = delete;

  /// Simulates a frame in `steps` contact steps: repulsion at the start of each, detection and impact zones over its
  /// motion. What lies in between is the solver's.
  void frame(int steps);
  Positions positions() const;

  /// Largest difference between the forces of these elements and the engine's on a crumpled cloth, relative to the
  /// largest force: that the energies are the same.
  double force_mismatch() const;

 protected:
  /// Moves x_ and v_ on by step_s. contacts: linearised at the start of the step.
  virtual void advance(double step_s, std::span<const simulation::ContactForce> contacts) = 0;

  /// Gravity and the pressure of the air, m/s^2 per vertex: explicit, as the engine has them.
  void find_accelerations(double step_s, std::vector<Double4>& accelerations) const;

  const simulation::Scene& scene_;
  simulation::StretchingTable table_;
  std::vector<RivalFace> faces_;
  std::vector<RivalHinge> hinges_;
  std::vector<RivalPin> pins_;
  std::vector<float> masses_, inverse_masses_;  // per vertex; one more without mobility, for lanes without element
  std::vector<Double4> x_, v_;                  // likewise

 private:
  Topology garment_;
  double face_density_;  // kg/m^2
  std::vector<double> masses_double_, inverse_masses_double_;
  std::optional<simulation::ContactSystem> contact_;
  ThreadPool pool_{1};
};

}  // namespace pleat::bench
