// Vertex block descent (Chen, Liu, Yang, Yuksel 2024): implicit Euler's objective, minimised vertex by vertex.
#pragma once

#include <vector>

#include "tests/bench/rivals/lanes.hpp"
#include "tests/bench/rivals/rival_cloth.hpp"

namespace pleat::bench {

struct BlockDescentOptions {
  int iterations = 8;          ///< sweeps over all vertices a step
  double spectral_radius = 0;  ///< of Chebyshev's acceleration; 0: none
};

/// Vertices are coloured so that no element has two of a colour. A vertex's 3x3 Newton system is summed over its faces
/// and hinges, eight at a time, with the engine's positive semi-definite stiffness, and solved; Chebyshev's
/// semi-iterative acceleration works on whole sweeps. A contact step is one step.
class BlockDescent : public RivalCloth {
 public:
  BlockDescent(const simulation::Scene& scene, const Topology& garment, const Positions& start,
               const BlockDescentOptions& options);

 protected:
  void advance(double step_s, std::span<const simulation::ContactForce> contacts) override;

 private:
  // A vertex's force and the lower triangle of its stiffness: fx fy fz kxx kyx kyy kzx kzy, kzz.
  struct System {
    Float8 first{};
    float kzz = 0;
  };
  // The elements at the vertices of a colour. Corners are turned so that the vertex is corner 0 of its faces and of the
  // hinges whose edge it ends, and corner 2 of those whose wing it is.
  struct Colour {
    std::vector<std::uint32_t> vertices;
    std::vector<Face8> faces;
    std::vector<Hinge8> edge_ends, wings;
  };
  void colour_vertices();
  void start_sweeps(double step_s);
  void sweep(double step_s, std::span<const simulation::ContactForce> contacts);
  void add_elements(const Colour& colour);
  void add_hinge(const Hinge8& hinge, std::size_t corner);
  void add(const Lanes& vertices, const Float8 (&values)[9]);
  void add_contact(std::uint32_t vertex, float h, const simulation::ContactForce& contact, System& system) const;

  BlockDescentOptions options_;
  std::vector<Colour> colours_;
  std::vector<System> systems_;                                   // per vertex
  std::vector<std::vector<std::uint32_t>> contacts_at_;           // per vertex
  std::vector<Double4> accelerations_, step_start_, inertial_;    // inertial_: y of the objective
  std::vector<Double4> last_velocities_, sweep_start_, earlier_;  // earlier_: the sweep before the last
};

}  // namespace pleat::bench
