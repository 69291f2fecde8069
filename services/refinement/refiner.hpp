// Makes fine frames clean: free of penetrations and of self-intersections ([MFSR] section 5.2, [DT-S] section 2.3).
// docs/refinement.md explains the method and what it guarantees.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat {

struct RefinementOptions {
  double clearance_m = 0.002;  ///< vertices keep this distance from obstacles; 0 to 0.1
  int obstacle_rounds = 3;     ///< Laplacian-preserving solves per frame at most; 0 to 10
  int bisections = 6;          ///< halvings of the interpolation weight of an impact zone; 1 to 20
  int rounds = 4;              ///< repetitions of the search for impact zones; 1 to 20; the last takes the whole mesh
};

/// What happened to one frame.
struct RefinementReport {
  std::size_t pairs_before = 0, pairs_after = 0;                ///< intersecting pairs of faces; counted up to 50,000
  std::size_t penetrations_before = 0, penetrations_after = 0;  ///< faces that reach into an obstacle
  std::size_t zones = 0;                                        ///< impact zones that were blended
  std::size_t rounds = 0;                                       ///< searches for impact zones that found some
  std::size_t vertices_moved = 0;                               ///< in all
  double largest_move_m = 0;                                    ///< of a vertex
  bool input_intersects = false;  ///< the coarse mesh itself is not clean: the result is no worse than the input
  double ms = 0;                  ///< time in refine()
  bool clean() const { return pairs_after == 0 && penetrations_after == 0; }
};

struct RefinedMesh {
  Positions positions;  ///< (V_fine x 3)
  RefinementReport report;
};

/// One per stream: keeps trees and factorisations. Not for several threads. Frames are independent of each other.
class Refiner {
 public:
  /// subdivision: of `coarse`. Throws kInvalidArgument for options out of range or unusable obstacles.
  Refiner(const Topology& coarse, const Subdivision& subdivision, std::span<const ObstacleShape> obstacles,
          const RefinementOptions& options = {});
  ~Refiner();
  Refiner(Refiner&&) noexcept;
  Refiner& operator=(Refiner&&) noexcept;

  /// The fine frame made clean. If the coarse frame is clean (as in judge.hpp), so is the result. If it is not, the
  /// result has no more offences than the fine input, and the report says input_intersects.
  /// coarse: (V_coarse x 3), fine: (V_fine x 3), obstacles: of this frame. Throws kInvalidArgument for wrong sizes,
  /// values that are not finite, or unusable obstacles; the refiner stays usable.
  RefinedMesh refine(const Positions& coarse, const Positions& fine, std::span<const ObstacleFrame> obstacles);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat
