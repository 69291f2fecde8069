// Contact: repulsion forces, and the guarantee that a step ends without self-intersections and penetrations.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/mesh/ccd.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/swept_bvh.hpp"
#include "services/simulation/dynamics.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// What resolve() had to do.
struct Resolution {
  std::uint64_t impacts = 0;
  std::uint64_t rigid_zones = 0;
  std::uint64_t rounds = 0;
  bool yielded = false;       ///< hard handles gave way to what stood against them
  bool cut = false;           ///< what collides was stopped: obstacles and hard handles may lag behind their script
  std::uint64_t stopped = 0;  ///< cloth vertices that were, by a cut
};

/// A place where a state is not clean.
struct Violation {
  enum class Kind : std::uint8_t {
    kCrossing,  ///< the segment particles[0]-[1] meets the triangle particles[2], [3], [4]
    kTouch,     ///< two primitives of particles[0..3] are too close
    kInside,    ///< the cloth vertex particles[0] is inside an obstacle
  };
  Kind kind;
  std::array<std::uint32_t, 5> particles{kNone, kNone, kNone, kNone, kNone};
  std::uint32_t face = kNone, other_face = kNone;  ///< kCrossing: faces of the cloth; the other kNone for an obstacle
  std::uint32_t obstacle = kNone;                  ///< index in the scene; kNone for the cloth itself
  /// kTouch and kInside: what to do. sum weights[k] particles[k] has to move by `depth` along `normal`.
  std::array<double, 4> weights{};
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double depth = 0;
};

/// Collision particles are the cloth's vertices, then the points of the obstacles in the scene's order (obstacles.hpp).
/// Obstacles never yield: they have no mass in here. One instance serves one cloth; results do not depend on the thread
/// count.
class ContactSystem {
 public:
  /// areas: m^2 per cloth vertex. rest: sets the order of the hierarchy, and the scale of the thickness.
  ContactSystem(const Topology& cloth, const Points& rest, std::vector<double> areas, const Scene& scene);

  /// resolve() asks between its rounds, and throws kCancelled when the answer is yes.
  void stop_when(std::function<bool()> stopped) { stopped_ = std::move(stopped); }

  std::size_t cloth_count() const { return cloth_count_; }
  std::size_t particle_count() const { return particle_count_; }
  double thickness() const { return thickness_; }  ///< metres, of the repulsion layer
  std::span<const std::array<std::uint32_t, 3>> cloth_faces() const { return std::span(faces_).first(cloth_faces_); }
  /// Of the cloth, then of the obstacle meshes.
  std::span<const std::array<std::uint32_t, 2>> edges() const { return edges_; }
  /// Per cloth vertex, which of the scene's layers it belongs to. Empty where there are none.
  std::span<const std::uint32_t> layers() const { return layers_; }

  /// Particle positions of the obstacles in their scripted places at a time, in particle order from cloth_count() on.
  Points obstacle_particles(double time_s) const;
  /// The same into memory that is reused.
  void obstacle_particles(double time_s, Points& particles) const;

  /// Throws kInvalidArgument, naming faces and obstacles, unless the positions (all particles) are free of
  /// self-intersections and penetrations with some clearance. Cloth that is nearer to an obstacle here than
  /// where the repulsion layer carries its weight is not pushed out at once: its layer begins so thin that it stays
  /// where it is, and grows by kLayerSpeed.
  void check_start(const Points& positions, ThreadPool& pool);

  /// Where the positions (all particles) are not clean: crossings, touches and vertices inside, in this order; every
  /// pair of faces once. Empty for a state from which resolve() may start.
  std::vector<Violation> violations(const Points& positions, ThreadPool& pool);
  std::string describe(const Violation& violation) const;

  static constexpr double kLayerSpeed = 0.01;  ///< m/s

  /// Repulsion and friction for the step that starts at the positions, time_s after the start. velocities: of all
  /// particles, the obstacles' being those of the coming step. Uses the pairs found by the last resolve() if it ended
  /// at these positions.
  std::vector<ContactForce> repulsion(const Points& positions, const Points& velocities, std::span<const double> masses,
                                      double time_s, double step_s, ThreadPool& pool);

  /// Changes `end` so that the linear motion from `start` (clean) to `end` is free of collisions.
  /// inverse_masses: of the cloth vertices; 0 for prescribed ones, which move as prescribed unless nothing else will
  /// do. Then those that collide have the inverse masses in `yielding`; empty: they never yield. `start`, `end`: all
  /// particles.
  Resolution resolve(const Points& start, Points& end, std::span<const double> inverse_masses,
                     std::span<const double> yielding, ThreadPool& pool);

 private:
  // Metres. A pair that comes closer than kGap has collided; impacts leave it at 5 kGap to a tenth of the thickness.
  static constexpr double kGap = 2e-5;
  enum class Kind : std::uint8_t { kVertexFace, kEdgeEdge, kSphereFace };
  struct Pair {
    std::array<std::uint32_t, 4> v;
    Kind kind;
    float minimum;  // distance that must remain: the radius of a sphere or a capsule, or 0
  };
  // n . sum w x >= distance.
  struct Impact {
    Pair pair;
    std::array<double, 4> weights;
    Eigen::Vector3d normal;
    double distance;
    double multiplier = 0;
  };

  // Pairs of cloth faces that share a vertex, or have vertices that an edge joins, are always near each other, and
  // rarely in danger. Each remembers how far its faces and the one between them may deform (deformation_ of all
  // together) before it must be looked at again.
  struct Neighbours {
    std::uint32_t f, g;
    std::uint32_t between;  // a face with the edge; f where they share a vertex
    std::uint32_t owned;    // as owned_pairs(), without pairs that share a vertex
    double safe_until;
  };

  ClosestPoints closest(const Pair& pair, const Points& x) const;
  std::optional<Collision> collide(const Pair& pair, const Points& start, const Points& end) const;
  bool resolve_rounds(const Points& start, Points& end, std::span<const double> inverse_masses, ThreadPool& pool,
                      std::vector<Impact>& impacts, Resolution& result);
  std::uint64_t cut(const Points& start, Points& end, ThreadPool& pool);
  void find_pairs(const Points& start, const Points& end, ThreadPool& pool);
  void add_round_pairs(const Points& start, const Points& end, double margin);
  template <typename Add>
  void repel_from_capsule(const Pair& pair, const Points& x, std::vector<std::uint32_t>& touched, const Add& add) const;
  void find_crossings(const Points& x, ThreadPool& pool, std::vector<Violation>& found) const;
  void find_touches(const Points& x, std::vector<Violation>& found) const;
  void begin_layer(const Points& x);
  void find_inside(const Points& x, std::vector<Violation>& found) const;
  std::uint32_t obstacle_of(std::uint32_t particle) const;
  std::uint32_t owned_pairs(std::uint32_t f, std::uint32_t g) const;
  void append_pairs(std::uint32_t f, std::uint32_t g, std::uint32_t owned, std::vector<Pair>& out) const;
  std::uint32_t apart(std::span<const SweptBvh::Pair> faces) const;
  double keep_if_close(const Pair& pair, const Points& start, const Points& end, std::vector<Pair>& out) const;
  void keep_close(std::span<const Pair> candidates, const Points& start, const Points& end, std::vector<Pair>& out,
                  std::span<double> clearances) const;
  void take_kept(std::size_t parts);
  void find_neighbours();
  void find_layers();
  std::string name_of_face(std::uint32_t f) const;
  double deformation_of(const Neighbours& n) const {
    return deformation_[n.f] + deformation_[n.g] + (n.between != n.f ? deformation_[n.between] : 0);
  }
  bool is_joined(std::uint32_t f, std::uint32_t g) const;
  void add_neighbours(const Points& start, const Points& end, ThreadPool& pool);
  void project(std::vector<Impact>& impacts, std::span<const double> inverse_masses, Points& end) const;
  bool move_rigidly(const std::vector<Impact>& impacts, std::span<const double> inverse_masses, const Points& start,
                    Points& end, std::uint64_t& zones) const;
  double inverse_mass(std::span<const double> inverse_masses, std::uint32_t particle) const {
    return particle < cloth_count_ ? inverse_masses[particle] : 0.0;
  }

  const Scene& scene_;
  std::function<bool()> stopped_;
  std::size_t cloth_count_ = 0, cloth_faces_ = 0, particle_count_ = 0;
  std::vector<std::array<std::uint32_t, 3>> faces_;  // cloth, then obstacle meshes
  std::vector<std::array<std::uint32_t, 2>> edges_;
  // Every vertex and every edge belongs to one of its faces, so that a pair of them is met once only.
  std::vector<std::array<std::uint32_t, 3>> own_edges_;  // edges that a face owns, kNone elsewhere
  std::vector<std::uint8_t> own_bits_;                   // which of a face's vertices, and above its edges, these are
  std::vector<std::uint32_t> layers_;                    // of cloth vertices
  std::vector<double> areas_;                            // of cloth vertices
  std::vector<double> edge_areas_, face_areas_;
  std::vector<std::uint32_t> first_particle_, first_face_;  // per obstacle, and the ends; no faces: not a mesh
  // Spheres (b is kNone) and capsules.
  struct Round {
    std::uint32_t a, b;
    double radius;
  };
  std::vector<Round> rounds_;
  double thickness_ = 0;
  std::vector<double> start_lag_;  // per cloth vertex: what its layer towards obstacles lacks at the start; or empty
  double slack_ = 0;  // metres that vertices may move after find_pairs before the pairs must be found again

  std::vector<Neighbours> neighbours_;
  // Of each face, those later ones that an edge joins to it, eight by eight, filled up with kNone.
  std::vector<std::uint32_t> joined_, joined_first_;
  std::vector<double> deformation_;  // per cloth face: largest change of an edge vector, summed over find_pairs calls

  SweptBvh cloth_bvh_, obstacle_bvh_;
  std::vector<SweptBox> boxes_;  // of all particles
  // Of all particles, in float32.
  struct Moving {
    Float4 end, motion;
  };
  std::vector<Moving> moving_;
  // What a part of a search works with.
  struct Candidates {
    std::vector<Pair> pairs, kept;
  };
  std::vector<Candidates> parts_;
  std::vector<SweptBvh::Pair> face_pairs_;
  std::vector<Pair> pairs_;
  Points pairs_end_;  // the end positions for which pairs_ was found
  // What resolve() was asked for (empty until something collides), and what its last round began with.
  Points wanted_, before_;
};

}  // namespace pleat::simulation
