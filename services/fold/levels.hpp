// The coarser meshes of a subdivision, whose stretch is solved before the fine one's: tension reaches far within a step
// (Mueller 2008, hierarchical position based dynamics; docs/fold.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/subdivision.hpp"
#include "services/fold/constraints.hpp"
#include "services/fold/rings.hpp"

namespace pleat::fold {

class CoarserLevels {
 public:
  /// subdivision: of `coarse`, with material coordinates. No levels if it has no rounds.
  CoarserLevels(const Topology& coarse, const Subdivision& subdivision, const simulation::Material& material);

  /// fixed: vertices that stay, (V_fine); the time that a solve() stands for, s. Without any fixed vertex the levels
  /// have a tenth of their stiffness.
  void set_step(std::span<const char> fixed, float step_s);

  /// One pass over the stretched faces of every level, the coarsest first; what that moves carries the finer vertices
  /// along, smoothly. The coarsest faces are as large as folds: their moves are averaged over neighbours before. x: at
  /// least V_fine + 1 vertices. O(V_fine levels).
  void solve(std::span<Float4> x);

 private:
  struct Level {
    std::uint32_t size;  ///< its vertices are the first of the fine mesh
    std::vector<float> inverse_masses;
    FacePacks faces;
  };
  // The ends of the edge that a vertex halves, and the vertices opposite to it, or the ends again at a border.
  struct Parents {
    std::array<std::uint32_t, 2> ends, opposite;
  };
  void smooth_moves();
  void add_parents(const Topology& mesh, const Subdivision& subdivision, std::size_t round);

  std::vector<Level> levels_;
  std::vector<Parents> parents_;
  Rings rings_;              // of the coarsest level
  std::vector<char> fixed_;  // as set_step() has it
  std::vector<Float4> moved_, smoothed_;
};

}  // namespace pleat::fold
