// Wrinkles by example: Zurdo, Brito, Otaduy, "Animating Wrinkles by Example on Non-Skinned Cloth", IEEE TVCG 19(1),
// 2013. A baseline without learning of weights; docs/superres.md says how it is read here. Free of LibTorch.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "common/store/dataset.hpp"

namespace pleat::superres {

struct ZurdoOptions {
  int examples = 64;         ///< poses kept, at least 1
  int rings = 3;             ///< edges up to this many steps from a coarse vertex describe its pose, 1 to 8
  double smoothness = 1e-4;  ///< of the interpolation, over the mean distance of the examples; 0: exact at them
};

/// One pose of the training data.
struct ZurdoPose {
  Positions coarse;  ///< (V_coarse x 3)
  Positions fine;    ///< (V_fine x 3)
};

/// Interpolates the displacements of examples from the barycentrically upsampled coarse mesh. At each coarse vertex the
/// pose is the ratios of the nearby edges' lengths to their rest lengths, weighted by nearness; the examples' weights
/// are radial basis functions of the distance in it (kernel |d|, with a constant, so that they sum to 1). A fine vertex
/// takes its parents' weights barycentrically and its displacements in a frame that moves with the coarse surface.
class ZurdoWrinkles {
 public:
  /// mesh: fine is the midpoint subdivision of coarse. count poses are offered; pose(k) is called in ascending order,
  /// and again for those chosen: the first, then always the one farthest from all chosen ones.
  /// Throws kInvalidArgument for options out of range, no poses, or poses of other sizes.
  ZurdoWrinkles(const MeshPair& mesh, std::size_t count, const std::function<ZurdoPose(std::size_t)>& pose,
                const ZurdoOptions& options = {});
  ~ZurdoWrinkles();
  ZurdoWrinkles(ZurdoWrinkles&&) noexcept;
  ZurdoWrinkles& operator=(ZurdoWrinkles&&) noexcept;

  /// The poses that were chosen.
  const std::vector<std::size_t>& examples() const;

  /// coarse: (V_coarse x 3). Returns (V_fine x 3). O(examples (edges near a vertex V_coarse + examples V_coarse +
  /// V_fine)).
  Positions synthesize(const Positions& coarse) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The frames of a data set's training split, every n-th, so that at most `most` are offered. Throws kNotFound if
/// there are none.
ZurdoWrinkles train_zurdo(const DatasetReader& dataset, const ZurdoOptions& options = {}, std::size_t most = 1000);

}  // namespace pleat::superres
