// Elastic forces of a cloth and one linearised implicit Euler step (Baraff and Witkin 1998; docs/simulation.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/simulation/averages.hpp"
#include "services/simulation/block_matrix.hpp"
#include "services/simulation/element_packs.hpp"
#include "services/simulation/elements.hpp"
#include "services/simulation/multilevel.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

using Points = std::vector<Eigen::Vector3d>;

/// A spring (or a prescribed place) between a vertex and a point of the end of the step.
struct Pin {
  std::uint32_t vertex;
  Eigen::Vector3d target;
  double stiffness = 0;  ///< N/m
  bool hard = false;     ///< the vertex is at the target at the end of the step
};

/// A repulsion linearised at the start of a step. Vertices that are not free (obstacles) have index kNone: their
/// motion is in `approach`.
struct ContactForce {
  std::array<std::uint32_t, 4> vertices;
  std::array<float, 4> weights;
  Eigen::Vector3f normal;    ///< unit; positive weights are pushed along it
  float force;               ///< N
  float stiffness;           ///< N/m along the normal
  float friction;            ///< N s/m across it
  Eigen::Vector3f approach;  ///< sum of weights times velocities, obstacles included, m/s

  /// What a velocity of the contact's point changes in the impulse of a step.
  Eigen::Matrix3f velocity_block(float step_s) const {
    const Eigen::Matrix3f nn = normal * normal.transpose();
    return step_s * step_s * stiffness * nn + step_s * friction * (Eigen::Matrix3f::Identity() - nn);
  }
};

/// One mesh's elastic model and its solver. The pattern of the matrix and all rest data are computed once.
class Dynamics {
 public:
  /// mesh: rest shape with material coordinates. A second level ([MFSR] section 4.2, H1) may be added: `coarse` whose
  /// vertex i is vertex feature_vertices[i] of mesh; its stretching and bending act there too, its mass does not.
  Dynamics(const Topology& mesh, const Scene& scene, const Topology* coarse = nullptr,
           std::span<const std::uint32_t> feature_vertices = {});

  /// Tells how the mesh was subdivided, which makes the linear solver need far fewer iterations.
  void use_levels(const Subdivision& subdivision);

  /// Lets steps hold the averages over the hats of a subdivided mesh's coarse vertices (Step::frequency).
  void track_averages(const Subdivision& subdivision, const Faces& coarse_faces);

  std::size_t vertex_count() const { return masses_.size(); }
  const std::vector<double>& masses() const { return masses_; }  ///< kg per vertex, lumped
  const std::vector<double>& areas() const { return areas_; }    ///< m^2 per vertex, a third of its faces

  /// Internal forces (N) and energy (J) at positions, for tests and diagnostics. Does not touch the state.
  Points internal_forces(const Points& positions) const;
  double internal_energy(const Points& positions) const;

  struct Step {
    double length_s;
    double damping_s;
    Eigen::Vector3d gravity;
    Wind wind;
    std::span<const Pin> pins;
    std::span<const ContactForce> contacts;
    double frequency = 0;                      ///< rad/s, with which averages are held to those of the targets
    std::span<const Eigen::Vector3d> targets;  ///< (V) m, at the end of the step; read if there is a frequency
    double tolerance = 3e-3;  ///< of the preconditioned residual, relative to that of the right-hand side
    int max_iterations = 400;
  };

  /// The velocities at the end of a step of linearised implicit Euler. `velocities` is replaced; positions stay.
  /// Returns the iterations of the linear solver.
  int solve(const Points& positions, Points& velocities, const Step& step, ThreadPool& pool);

  double assembly_ms() const { return assembly_ms_; }  ///< of the last solve
  double solve_ms() const { return solve_ms_; }

  /// What a step carries to the next besides positions and velocities: the reference angles of the hinges and the last
  /// velocity change, which starts the linear solver.
  std::vector<float>& reference_angles() { return reference_angles_; }
  std::vector<Float4>& last_change() { return change_; }
  void forget_last_change() { std::fill(change_.begin(), change_.end(), Float4{}); }

  /// Whether an edge of the cloth gets more than twice as long (and as it was at rest, roughly) between two states:
  /// more than a step of a stable motion can do.
  bool bursts(const Points& start, const Points& end) const;

 private:
  // Vertices from which on threads pay in an iteration: over a small mesh one takes less time than waking them up.
  static constexpr std::size_t kWorthThreads = 4 * kVertexGrain;

  struct Face {
    std::array<std::uint32_t, 3> v;
    TriangleRest<float> rest;
  };
  struct Hinge {
    std::array<std::uint32_t, 4> v;
    HingeRest<float> rest;
  };
  void add_level(const Topology& mesh, std::span<const std::uint32_t> map, const Scene& scene);
  void choose_order(const Topology& mesh);
  void build_packs();
  void build_pattern();
  void assemble(const Points& positions, const Points& velocities, const Step& step, ThreadPool& pool);
  int conjugate_gradients(const Step& step, ThreadPool& pool);
  int swept_conjugate_gradients(const Step& step);
  bool add_to_matrix(const ContactForce& contact, float step_s);
  double add_contacts(const Step& step, std::span<const Float4> y, std::span<Float4> product) const;
  void correct_translation(const Step& step);
  void add_averages(const Step& step, ThreadPool& pool);

  std::uint32_t face_slot(std::size_t face) const;

  std::vector<Face> faces_;    // sorted by place, level by level
  std::vector<Hinge> hinges_;  // likewise
  // The solver works in an order in which neighbours on the cloth are neighbours in memory: place_ of a vertex, and the
  // vertex at a place. What is per vertex below is by place, except masses_ and areas_.
  std::vector<std::uint32_t> place_, vertex_at_;
  std::size_t mass_faces_ = 0;  // the faces that carry mass and air drag: the first level's
  StretchingTable table_;
  double density_;
  std::vector<double> masses_, areas_;

  BlockMatrix matrix_;
  Multilevel multilevel_;
  Averages averages_;
  float averages_scale_ = 0;  // of the step: h^2 omega^2, 0 without averages
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs_;
  // What a pair's off-diagonal block gathers: from faces, blocks at an offset into face_records_ (and in another list
  // those to be transposed), from hinges, two gradients at offsets into hinge_records_.
  struct PairSources {
    std::uint32_t face, transposed, hinge;  // begins; the ends are those of the next pair
  };
  std::vector<PairSources> sources_;
  std::vector<std::uint32_t> face_sources_, transposed_sources_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> hinge_sources_;
  // Per vertex: offsets of the face forces and of the hinge gradients (and of their hinge's record) that it gathers.
  std::vector<std::uint32_t> face_offsets_, face_corners_, hinge_offsets_, hinge_corners_;
  std::vector<FacePack> face_packs_;  // a level begins with a pack of its own
  std::vector<HingePack> hinge_packs_;
  std::size_t mass_packs_ = 0;

  ThreadPool alone_{1};

  // Per step.
  std::vector<Double4> positions_, velocities_;  // copies in registers' layout
  std::vector<float> face_records_, hinge_records_;
  std::vector<ContactForce> contacts_;                    // the step's, with places for vertices
  std::vector<ContactForce> outside_;                     // those of them that the matrix has no blocks for
  std::vector<float> whole_diagonal_, inverse_diagonal_;  // blocks of the matrix and the contacts
  std::vector<Float4> right_side_, change_, residual_, direction_, product_, preconditioned_, solved_;
  std::vector<char> fixed_;
  std::vector<float> reference_angles_;
  double assembly_ms_ = 0, solve_ms_ = 0;
};

}  // namespace pleat::simulation
