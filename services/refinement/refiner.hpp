// Makes fine frames clean: free of penetrations and of self-intersections ([MFSR] section 5.2, [DT-S] section 2.3).
// docs/refinement.md explains the method and what it guarantees.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::refinement {

struct RefinementOptions {
  double clearance_m = 0.002;  ///< vertices keep this distance from obstacles; 0 to 0.1
  int obstacle_rounds = 3;     ///< Laplacian-preserving solves per frame at most; 0 to 10
  int bisections = 5;          ///< weights of impact zones are found to 2^-bisections; 1 to 10
  int threads = 0;             ///< 0: as many as there are processors; the result does not depend on it
};

/// What happened to one frame.
struct RefinementReport {
  std::size_t pairs_before = 0, pairs_after = 0;                ///< intersecting pairs of faces; counted up to 50,000
  std::size_t penetrations_before = 0, penetrations_after = 0;  ///< faces that reach into an obstacle
  std::size_t zones = 0;                                        ///< impact zones: connected vertices that were blended
  std::size_t rounds = 0;                                       ///< searches for intersections in them
  std::size_t vertices_moved = 0;                               ///< in all
  double largest_move_m = 0;                                    ///< of a vertex
  double mean_move_m = 0;                                       ///< over all vertices
  bool input_intersects = false;  ///< the coarse mesh itself is not clean: the result is no worse than the input
  double ms = 0;                  ///< time in refine()
  bool clean() const { return pairs_after == 0 && penetrations_after == 0; }
};

struct RefinedMesh {
  Positions positions;  ///< (V_fine x 3)
  RefinementReport report;
};

/// One per stream: keeps trees, factorisations and memory. Not for several threads. Frames are independent of each
/// other: a frame's result does not depend on which frames came before, bit by bit.
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
  /// The same into memory that is reused: does not allocate once frames as difficult have been seen.
  void refine(const Positions& coarse, const Positions& fine, std::span<const ObstacleFrame> obstacles,
              RefinedMesh& result);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::refinement
