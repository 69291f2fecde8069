// The elastic constraints of a cloth, solved in packs: springs along edges and hinges across them (Macklin, Mueller and
// Chentanez 2016, XPBD; docs/fold.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"
#include "services/fold/lanes.hpp"
#include "services/simulation/material.hpp"

namespace pleat::fold {

/// Stiffness grows linearly with the stretch, from the one at rest to the other at a stretch by kFullStretch, and is
/// constant outside.
struct Spring {
  std::array<std::uint32_t, 2> v;
  float rest;                  ///< m
  float stiffness, stretched;  ///< N/m, at rest and stretched
};
inline constexpr float kFullStretch = 1.0f / 6;  ///< where materials are measured

/// Energy stiffness / 2 |sum_k weights[k] x_k|^2: the quadratic bending of a hinge that is flat at rest and hardly
/// stretched (Bergou et al. 2006). The sum's length is the hinge's angle, for small ones.
struct Hinge {
  std::array<std::uint32_t, 4> v;  ///< ends of the edge, opposite vertices
  std::array<float, 4> weights;    ///< 1/m
  float stiffness;                 ///< N m
};

/// kg per vertex: a third of its faces' in material coordinates. (V)
std::vector<float> lumped_masses(const Topology& mesh, double density);

/// Springs along all edges that together resist as the sheet does (Van Gelder 1998: E sum of areas / l^2), E the
/// material's modulus in the edge's direction. Lengths in material coordinates; at seams the mean of both sides'.
std::vector<Spring> edge_springs(const Topology& mesh, const simulation::Material& material);

/// Hinges of all inner edges, with the bending stiffness that the simulation gives them (simulation/elements.hpp) at a
/// curvature of 10 1/m.
std::vector<Hinge> edge_hinges(const Topology& mesh, const simulation::Material& material);

/// Springs in packs. Positions are arrays of at least `nowhere` + 1 vertices, of which the last is a scratch place.
class SpringPacks {
 public:
  SpringPacks() = default;
  SpringPacks(std::vector<Spring> springs, std::uint32_t nowhere);

  /// inverse_masses: 1/kg per vertex, 0 where it is fixed; the time that a solve() stands for, s.
  void set_step(std::span<const float> inverse_masses, float step_s);

  /// One pass over all springs (from lambda = 0): O(springs). `stretched_only`: those that are too short stay so.
  void solve(std::span<Float4> x, bool stretched_only) const;

 private:
  // Per lane: the rest length, the ends' mobilities (0 where there is no spring), and stiffness times step^2: at rest,
  // and what it grows by.
  struct Pack {
    std::array<Lanes, 2> v{};
    Float8 rest{}, mobility0{}, mobility1{}, stiffness = broadcast8(1), growth{};
  };
  std::vector<Spring> springs_;
  std::vector<std::vector<std::uint32_t>> members_;
  std::vector<Pack> packs_;
};

/// Hinges in packs; as SpringPacks.
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
