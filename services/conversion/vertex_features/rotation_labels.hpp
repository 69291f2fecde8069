// Which of the many names of a rotation each vertex gets, so that what a network reads is continuous over the mesh and
// over time (docs/vertex-features.md).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "services/conversion/vertex_features/one_rings.hpp"
#include "services/conversion/vertex_features/vertex_spec.hpp"

namespace pleat::conversion {

inline int rotation_channels(RotationCode code) { return code == RotationCode::kLogarithm ? 3 : 4; }

/// What a frame's labels are worth. An edge is torn if the names at its ends are more than pi apart (logarithms), or on
/// opposite sides (quaternions).
struct LabelReport {
  std::size_t torn_by_time = 0;  ///< edges torn after the names nearest to the last frame's; 0 in a first frame
  std::size_t torn_edges = 0;    ///< in the result
  float largest_jump = 0;        ///< of an edge: rad for logarithms, |difference| for quaternions
  float largest_step = 0;        ///< of a vertex since the last frame; 0 in a first frame
};

/// Solves min over labels of sum_edges |x_i - x_j|^2 + weight sum_i |x_i - x_i(t-1)|^2 approximately, the same way
/// every time: the names nearest to the last frame's; where that tears edges, relaxation, then growing the
/// neighbourhood of the torn edges anew, then the whole mesh. A first frame is grown from the vertex of the smallest
/// angle of each connected part, the smallest jump first. Immutable.
class RotationLabels {
 public:
  /// edges: each once. temporal_weight: >= 0.
  RotationLabels(RotationCode code, std::size_t vertex_count, const std::vector<OneRings::WeightedEdge>& edges,
                 float temporal_weight = 0.1f);

  /// rotations: (V), (axis, angle in [0, pi]) for logarithms, unit quaternions else. previous: (V) the last frame's
  /// labels, or empty. labels: (V), a logarithm's fourth lane is 0.
  LabelReport label(std::span<const Float4> rotations, std::span<const Float4> previous,
                    std::vector<Float4>& labels) const;

  /// The name of a rotation that is nearest to `target`.
  Float4 pick(Float4 rotation, Float4 target) const;

 private:
  struct Frame {
    std::span<const Float4> rotations, previous;
  };
  std::span<const std::uint32_t> neighbours(std::size_t vertex) const {
    return {neighbours_.data() + offsets_[vertex], neighbours_.data() + offsets_[vertex + 1]};
  }
  std::size_t count_torn(const std::vector<Float4>& labels) const;
  float energy_at(const Frame& frame, const std::vector<Float4>& labels, std::size_t vertex, Float4 label) const;
  void relax(const Frame& frame, std::vector<Float4>& labels) const;
  void grow(const Frame& frame, std::vector<std::uint8_t>& labelled, std::vector<Float4>& labels) const;
  std::vector<std::uint8_t> away_from_torn(const std::vector<Float4>& labels) const;
  float smallness(Float4 rotation) const;

  RotationCode code_;
  float temporal_weight_;
  float torn_squared_;
  std::vector<std::array<std::uint32_t, 2>> edges_;
  std::vector<std::uint32_t> offsets_, neighbours_;  // compressed rows
};

}  // namespace pleat::conversion
