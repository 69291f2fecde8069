// Vertex positions from deformation gradients: one sparse factor, correction passes, anchors
// (docs/vertex-features.md).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "services/conversion/vertex_features/factor.hpp"
#include "services/conversion/vertex_features/one_rings.hpp"

namespace pleat::conversion {

/// Which vertices say where the cloth is. Every connected part of the mesh needs one of either kind.
struct Anchors {
  std::vector<std::uint32_t> handles;  ///< take their places exactly
  std::vector<std::uint32_t> soft;     ///< are drawn to their places; a handle among them counts as a handle
  /// Of a soft anchor, times the mean diagonal of the Laplacian. 0: a part without handles keeps the shape that the
  /// gradients give it, and is moved so that the mean of its soft anchors is right.
  double weight = 0.1;
};

/// Memory that solve() reuses.
struct CoordinateScratch {
  std::vector<Double4> unknowns;
  std::vector<Float4> positions;
  GradientField difference;
};

/// min over p of sum_i sum_j w_ij |(p_i - p_j) - T_i (r_i - r_j)|^2, that is L p = b(T) with L_ij = -2 w_ij and
/// b_i = sum_j w_ij (T_i + T_j)(r_i - r_j). One-ring gradients are averages, so the answer is too smooth: a wave of l
/// edges keeps s = cos^2(pi / l) of its amplitude. Each correction pass, p += L^-1 b(T - T(p)) with the same factor,
/// leaves the (1 - s)-th part of what lacks. Immutable.
class CoordinateSolver {
 public:
  /// Throws kInvalidArgument, beginning with `name`, for an anchor out of range, and for a vertex whose connected part
  /// has none.
  CoordinateSolver(std::shared_ptr<const OneRings> rings, Anchors anchors, const std::string& name);

  const Anchors& anchors() const { return anchors_; }
  const OneRings& rings() const { return *rings_; }

  /// handles, soft: (handles x 3) and (soft x 3) places in metres, in the axes of the gradients. passes: >= 0.
  /// positions: (V x 3), resized. Throws kInvalidArgument for wrong sizes and for a result that is not finite (then an
  /// input was not), naming the vertex.
  void solve(const GradientField& gradients, const Positions& handles, const Positions& soft, int passes,
             CoordinateScratch& scratch, Positions& positions) const;

  /// The passes alone, from positions that are nearly right already: where they have the gradients, nothing moves.
  /// Handles stay; soft anchors resist. positions: (V x 3), metres, in the axes of the gradients. Throws as solve().
  void correct(const GradientField& gradients, int passes, CoordinateScratch& scratch, Positions& positions) const;

 private:
  struct Pull {  // an edge from an unknown to a fixed vertex
    std::uint32_t slot, fixed;
    double weight;  // 2 w_ij
  };
  struct Neighbour {
    std::uint32_t vertex;
    float rx, ry, rz;  // w_ij (r_i - r_j)
  };
  struct Part {  // a connected part that the soft anchors place as a whole
    std::vector<std::uint32_t> vertices;
    std::vector<std::uint32_t> soft;  // into anchors_.soft
  };
  void build_system(const std::string& name);
  void build_rows();
  void load(const GradientField& gradients, std::vector<Double4>& unknowns) const;
  void check_gradients(const GradientField& gradients) const;
  void run_passes(const GradientField& gradients, int passes, CoordinateScratch& scratch) const;
  void store(const std::vector<Float4>& from, Positions& positions) const;
  void place_parts(const Positions& soft, std::vector<Float4>& positions) const;

  std::shared_ptr<const OneRings> rings_;
  Anchors anchors_;
  std::vector<std::uint8_t> fixed_;  // handles, and one vertex of each part in parts_
  std::vector<std::uint32_t> slot_;  // (V) place among the unknowns, kNone for fixed ones
  std::vector<Pull> pulls_;
  std::vector<Part> parts_;
  double soft_weight_ = 0;  // weight times the mean diagonal
  std::vector<std::uint32_t> row_offsets_;
  std::vector<Neighbour> row_entries_;
  std::vector<std::array<float, 3>> row_sums_;  // sum_j w_ij (r_i - r_j)
  std::unique_ptr<const LaneFactor> factor_;    // null where nothing is unknown
};

}  // namespace pleat::conversion
