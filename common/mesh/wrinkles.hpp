// How much a cloth is wrinkled, scale by scale. docs/metrics.md has the definitions.
//
// A network that answers with the mean of all possible folds is near the reference and flat: distances do not see what
// an eye sees at once. These figures ask for the amount of wrinkling at each scale, wherever the folds are.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// Rounds of one-ring averaging at the bands' ends: band b is what goes away between kBandRounds[b] and
/// kBandRounds[b + 1] rounds, scales of about 1, 2, 4 and 8 edges.
inline constexpr std::array<int, 5> kBandRounds{0, 1, 4, 16, 64};
inline constexpr std::size_t kWrinkleBands = kBandRounds.size() - 1;

struct WrinkleFigures {
  /// Mean over the vertices of |S^j n - S^k n|^2, where n are the unit vertex normals, S the one-ring average and j, k
  /// the rounds at the band's ends. 0 for a flat cloth.
  std::array<double, kWrinkleBands> bands{};
  /// Mean of |n - S n| over the feature vertices, over the mean over all others: 1 where the coarse mesh leaves no
  /// trace. 1 for a flat cloth.
  double lattice = 1;
};

/// Measures frames of one mesh. measure() may be called from several threads.
class WrinkleMeter {
 public:
  /// feature_vertices: indices of the coarse vertices. Throws kInvalidArgument for indices out of range. O(V + F).
  WrinkleMeter(Eigen::Index vertex_count, const Faces& faces, std::span<const std::uint32_t> feature_vertices);

  /// positions: (V x 3). Throws kInvalidArgument for another number of vertices. O(V) times the last of kBandRounds.
  WrinkleFigures measure(const Positions& positions) const;

 private:
  void average(const Positions& from, Positions& to) const;

  Faces faces_;
  std::vector<std::uint32_t> offsets_;     ///< (V + 1) rows into neighbours_
  std::vector<std::uint32_t> neighbours_;  ///< ascending, without the vertex itself
  std::vector<bool> is_feature_;
};

}  // namespace pleat
