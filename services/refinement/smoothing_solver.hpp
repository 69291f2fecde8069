// The Laplacian-preserving solve of the obstacle push, in single precision. Internal to this room.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::refinement {

/// Solves (stand_still I + L^T L) u = f for displacements u of all vertices, where L is the uniform Laplacian of the
/// mesh. The matrix is factorised once, in double; the factor is kept in float, its columns gathered to dense blocks,
/// and the three components of a vertex are one register, so that a solve reads the factor twice and nothing else.
class SmoothingSolver {
 public:
  /// stand_still > 0. O(V^1.5): about 0.1 s for 11,000 vertices.
  SmoothingSolver(const Faces& faces, Eigen::Index vertex_count, double stand_still);

  /// Clears the loads.
  void begin();
  void add_load(std::uint32_t vertex, const Eigen::Vector3f& load);
  /// Solves for the loads added since begin(), at the vertices that have loads. Reads only the part of the factor that
  /// they reach. Does not allocate; the result depends on the loads alone.
  void solve();
  /// After solve(): everywhere else, but where the solution has faded below `smallest` in all components it counts as
  /// zero from there on outwards.
  void spread(float smallest);
  /// 0 where solve() or spread() did not get.
  Eigen::Vector3f displacement(std::uint32_t vertex) const {
    const Lanes& u = x_[position_[vertex]];
    return {u[0], u[1], u[2]};
  }

  std::size_t factor_size() const { return values_.size(); }

 private:
  using Lanes = float __attribute__((vector_size(16)));
  // Columns [first, first + width) of the factor: a lower triangle, then `rows` rows below it, all row-major.
  struct Block {
    std::uint32_t first, width, rows;
    std::uint32_t row_list;  // into row_list_
    std::uint32_t parent;    // the next block up the elimination tree
    std::size_t values;      // into values_
  };
  void forward(const Block& block);
  void backward(const Block& block);

  std::vector<Block> blocks_;
  std::vector<std::uint32_t> block_of_;  // of a column
  std::vector<std::uint32_t> position_;  // column of a vertex
  std::vector<std::uint32_t> row_list_;
  std::vector<float> values_;
  std::vector<float> inverse_diagonal_;
  std::vector<Lanes> x_;
  std::vector<Lanes> gathered_;        // the x of one block's rows
  std::vector<std::uint8_t> reached_;  // blocks on the way from a load to the root
};

}  // namespace pleat::refinement
