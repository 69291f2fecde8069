// An additive multilevel preconditioner for meshes made by subdivision (Bramble, Pasciak and Xu 1990).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/base/parallel.hpp"
#include "services/simulation/averages.hpp"
#include "services/simulation/block_matrix.hpp"

namespace pleat::simulation {

/// What block-Jacobi on the fine mesh can't see, smooth errors, the coarser meshes can: z += sum over the coarser
/// levels of P D^-1 P^T r, P interpolating linearly along the edges, D the diagonal blocks of P^T A P. Symmetric and
/// positive definite together with block-Jacobi on the finest level.
class Multilevel {
 public:
  Multilevel() = default;
  /// level_sizes: vertices of every level, the finest last; a level's vertices are the first of the next one's. ends:
  /// of the edge that a vertex halves, per vertex (those of the coarsest level are not read). place: the matrix's row
  /// of a vertex. pairs: of the matrix.
  Multilevel(std::span<const std::uint32_t> level_sizes, std::span<const std::array<std::uint32_t, 2>> ends,
             std::span<const std::uint32_t> place, std::span<const std::pair<std::uint32_t, std::uint32_t>> pairs,
             const BlockMatrix& matrix);

  bool empty() const { return levels_.empty(); }
  /// A will have a multiple of the averages' Hessian besides the matrix: update() adds its diagonals.
  void add_averages(const Averages& averages);
  /// The matrix has new values; averages_scale: what the Hessian of the averages over omega^2 is multiplied with.
  /// O(the matrix's blocks) per level.
  void update(const BlockMatrix& matrix, float averages_scale, ThreadPool& pool);
  /// fixed: vertices whose z stays; their r must be 0.
  void add_corrections(std::span<const Float4> r, std::span<const char> fixed, std::span<Float4> z, ThreadPool& pool);

 private:
  // One coarser level. Vertex i gathers from the midpoints [child_begin[i], child_begin[i + 1]) of children.
  struct Level {
    std::size_t size = 0, next_size = 0;
    std::vector<std::uint32_t> child_begin, children;
    std::vector<std::uint32_t> places;  // in the next level, of all its vertices
    // Diagonal block i of P^T A P: sum of weight times the diagonal blocks, and times the off-diagonal ones and their
    // transposes.
    struct Term {
      std::uint32_t source;
      float weight;
    };
    std::vector<std::uint32_t> diagonal_begin, pair_begin;
    std::vector<Term> diagonal_terms, pair_terms;
    std::vector<float> inverse;
    std::vector<float> averages;  // diagonal of P^T H P over omega^2, empty without averages
    std::vector<Float4> residual, correction;
  };

  std::vector<Level> levels_;  // the coarsest first
  std::vector<std::array<std::uint32_t, 2>> ends_;
};

}  // namespace pleat::simulation
