// Contact: repulsion forces, and the guarantee that a step ends without self-intersections and penetrations.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/parallel.hpp"
#include "common/mesh/bvh.hpp"
#include "common/mesh/ccd.hpp"
#include "common/mesh/connectivity.hpp"
#include "services/simulation/dynamics.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// What resolve() had to do.
struct Resolution {
  std::uint64_t impacts = 0;
  std::uint64_t rigid_zones = 0;
  std::uint64_t rounds = 0;
  bool cut = false;  ///< the step was cut: obstacles and hard handles lag behind their script too
};

/// Collision particles are the cloth's vertices, then those of the obstacle meshes, then the spheres' centres.
/// Obstacles never yield: they have no mass in here. One instance serves one cloth; results do not depend on the thread
/// count.
class ContactSystem {
 public:
  /// areas: m^2 per cloth vertex. rest: sets the order of the hierarchy, and the scale of the thickness.
  ContactSystem(const Topology& cloth, const Points& rest, std::vector<double> areas, const Scene& scene);

  std::size_t cloth_count() const { return cloth_count_; }
  std::size_t particle_count() const { return particle_count_; }
  double thickness() const { return thickness_; }  ///< metres, of the repulsion layer

  /// Particle positions of the obstacles in their scripted places at a time, in particle order from cloth_count() on.
  Points obstacle_particles(double time_s) const;

  /// Throws kInvalidArgument, naming the faces or the obstacle, unless the positions (all particles) are free of
  /// self-intersections and penetrations with some clearance.
  void check_start(const Points& positions, ThreadPool& pool);

  /// Repulsion and friction for the step that starts at the positions. velocities: of all particles, the obstacles'
  /// being those of the coming step. Uses the pairs found by the last resolve() if it ended at these positions.
  std::vector<ContactForce> repulsion(const Points& positions, const Points& velocities, std::span<const double> masses,
                                      double step_s, ThreadPool& pool);

  /// Changes `end` so that the linear motion from `start` (clean) to `end` is free of collisions.
  /// inverse_masses: of the cloth vertices; 0 for prescribed ones. `start`, `end`: all particles.
  Resolution resolve(const Points& start, Points& end, std::span<const double> inverse_masses, ThreadPool& pool);

 private:
  enum class Kind : std::uint8_t { kVertexFace, kEdgeEdge, kSphereFace };
  struct Pair {
    std::array<std::uint32_t, 4> v;
    Kind kind;
    float minimum;  // distance that must remain: a sphere's radius, or 0
  };
  // n . sum w x >= distance.
  struct Impact {
    Pair pair;
    std::array<double, 4> weights;
    Eigen::Vector3d normal;
    double distance;
    double multiplier = 0;
  };

  ClosestPoints closest(const Pair& pair, const Points& x) const;
  std::optional<Collision> collide(const Pair& pair, const Points& start, const Points& end) const;
  void find_pairs(const Points& start, const Points& end, ThreadPool& pool);
  template <typename Use>
  void for_each_pair(std::uint32_t f, std::uint32_t g, bool boxes, const Use& use) const;
  double keep_if_close(const Pair& pair, const Points& start, const Points& end, std::vector<Pair>& out) const;
  void find_neighbours();
  void add_neighbours(const Points& start, const Points& end, ThreadPool& pool);
  bool share_vertex(std::uint32_t f, std::uint32_t g) const;
  void project(std::vector<Impact>& impacts, std::span<const double> inverse_masses, Points& end) const;
  bool move_rigidly(const std::vector<Impact>& impacts, std::span<const double> inverse_masses, const Points& start,
                    Points& end, std::uint64_t& zones) const;
  double inverse_mass(std::span<const double> inverse_masses, std::uint32_t particle) const {
    return particle < cloth_count_ ? inverse_masses[particle] : 0.0;
  }

  const Scene& scene_;
  std::size_t cloth_count_ = 0, cloth_faces_ = 0, particle_count_ = 0, first_sphere_ = 0;
  std::vector<std::array<std::uint32_t, 3>> faces_;  // cloth, then obstacle meshes
  std::vector<std::array<std::uint32_t, 2>> edges_;
  // Every vertex and every edge belongs to one of its faces, so that a pair of them is met once only.
  std::vector<std::array<std::uint32_t, 3>> own_edges_;     // edges that a face owns, kNone elsewhere
  std::vector<std::array<std::uint32_t, 3>> own_vertices_;  // likewise
  std::vector<double> areas_;                               // of cloth vertices
  std::vector<double> edge_areas_, face_areas_;
  std::vector<std::size_t> mesh_obstacles_, sphere_obstacles_;  // indices into scene.obstacles, in particle order
  double thickness_ = 0;
  double slack_ = 0;  // metres that vertices may move after find_pairs before the pairs must be found again

  // Pairs of cloth faces that share a vertex are always near each other, and rarely in danger. Each remembers how far
  // its faces may deform (deformation_ of both together) before it must be looked at again.
  struct Neighbours {
    std::uint32_t f, g;
    std::uint32_t first, last;  // into neighbour_pairs_
    double safe_until;
  };
  std::vector<Neighbours> neighbours_;
  std::vector<Pair> neighbour_pairs_;
  std::vector<double> deformation_;  // per cloth face: largest change of an edge vector, summed over find_pairs calls

  Bvh cloth_bvh_, obstacle_bvh_;
  std::vector<Box> vertex_boxes_, face_boxes_;
  std::vector<Pair> pairs_;
  Points pairs_end_;  // the end positions for which pairs_ was found
};

}  // namespace pleat::simulation
