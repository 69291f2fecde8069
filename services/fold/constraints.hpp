// The elastic constraints of a cloth, solved in packs: faces that are stretched and hinges between them (Macklin,
// Mueller and Chentanez 2016, XPBD; docs/fold.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/fold/lanes.hpp"
#include "services/simulation/material.hpp"

namespace pleat::fold {

inline constexpr float kFullStretch = 1.0f / 6;  ///< where materials are measured

/// A face that resists Green strain E as the sheet does: area / 2 (c11 E00^2 + 2 c12 E00 E11 + c22 E11^2 + 2 c33
/// E01^2). Each modulus grows linearly from the one at rest to that at a stretch by kFullStretch along u (c11), v (c22)
/// or the diagonal (c33), and is constant outside.
struct Face {
  std::array<std::uint32_t, 3> v;
  /// Of the material coordinates: x_u = du[0] (x_1 - x_0) + du[1] (x_2 - x_0), x_v likewise. 1/m
  std::array<float, 2> du, dv;
  float area;                          ///< m^2
  simulation::Moduli rest, stretched;  ///< N/m; c12 does not grow
};

/// Energy stiffness / 2 |sum_k weights[k] x_k|^2: the quadratic bending of a hinge that is flat at rest and hardly
/// stretched (Bergou et al. 2006). The sum's length is the hinge's angle, for small ones.
struct Hinge {
  std::array<std::uint32_t, 4> v;  ///< ends of the edge, opposite vertices
  std::array<float, 4> weights;    ///< 1/m
  float stiffness;                 ///< N m
};

/// kg per vertex: a third of its faces' in material coordinates. (V)
std::vector<float> lumped_masses(const Topology& mesh, double density);

/// All faces. Shapes in material coordinates; a face without area there resists nothing.
std::vector<Face> stretch_faces(const Topology& mesh, const simulation::Material& material);

/// Hinges of all inner edges, with the bending stiffness that the simulation gives them (simulation/elements.hpp) at a
/// curvature of 10 1/m.
std::vector<Hinge> edge_hinges(const Topology& mesh, const simulation::Material& material);

/// Faces in packs. Positions are arrays of at least `nowhere` + 1 vertices, of which the last is a scratch place.
class FacePacks {
 public:
  FacePacks() = default;
  FacePacks(std::vector<Face> faces, std::uint32_t nowhere);

  /// inverse_masses: 1/kg per vertex, 0 where it is fixed; the time that a solve() stands for, s; what the moduli are
  /// multiplied by.
  void set_step(std::span<const float> inverse_masses, float step_s, float stiffness = 1);

  /// One pass over all faces (from lambda = 0), the three strains of each together: O(faces). `stretched_only`: of the
  /// strain its positive part, so that a face that is too short in a direction stays so.
  void solve(std::span<Float4> x, bool stretched_only) const;

 private:
  // Per lane: derivatives and mobilities of the corners, their sums over corners (mobility du du, du dv, dv dv), and
  // the moduli times area and step^2, at rest and what they grow by.
  struct Pack {
    std::array<Lanes, 3> v{};
    std::array<Float8, 2> du{}, dv{};
    std::array<Float8, 3> mobility{};
    Float8 uu{}, uv{}, vv{}, c11{}, c12{}, c22{}, c33{}, growth11{}, growth22{}, growth33{};
  };
  std::vector<Face> faces_;
  std::vector<std::vector<std::uint32_t>> members_;
  std::vector<Pack> packs_;
};

/// Hinges in packs; as FacePacks.
class HingePacks {
 public:
  HingePacks() = default;
  HingePacks(std::vector<Hinge> hinges, std::uint32_t nowhere);
  void set_step(std::span<const float> inverse_masses, float step_s);
  void solve(std::span<Float4> x) const;

 private:
  struct Pack {
    std::array<Lanes, 4> v{};
    std::array<Float8, 4> weights{}, shares{};
  };
  std::vector<Hinge> hinges_;
  std::vector<std::vector<std::uint32_t>> members_;
  std::vector<Pack> packs_;
};

}  // namespace pleat::fold
