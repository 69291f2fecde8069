// Subdivision of coarse meshes, and the linear upsampling that belongs to it ([MFSR] section 4.1).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat {

/// A fine mesh made from a coarse one. The coarse vertices come first and keep their indices, so
/// feature_vertices[i] == i; it is stored all the same because other generators need not do so.
struct Subdivision {
  Topology fine;
  std::vector<std::uint32_t> feature_vertices;  ///< (V_coarse) indices into the fine mesh

  /// How it was made, round by round: vertices after 0, 1, ... rounds, and the ends of the edge that each vertex halves
  /// ((V_fine); a coarse vertex itself, twice). A round's vertices come after all earlier ones.
  std::vector<std::uint32_t> level_sizes;
  std::vector<std::array<std::uint32_t, 2>> halved_edges;

  /// Each fine vertex as a combination of the corners of one coarse face.
  std::vector<std::uint32_t> parent_face;                                ///< (V_fine) coarse face
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> barycentric;  ///< (V_fine x 3), rows sum to 1
};

/// Where a round puts the rest positions. Faces, numbering and material coordinates are the same with both rules.
enum class SubdivisionRule {
  kMidpoint,  ///< new vertices in the middle of the edges: the same surface
  kSmooth,    ///< on Loop's surface, but straight above the middle of the edges. Loop's own rule also slides vertices
              ///< across the surface where a mesh is irregular, away from their material coordinates: a flat sheet
              ///< would start stretched (the tablecloth by 0.56 to 1.68 times), and the surface would be the same.
  kLoop,      ///< Loop's (1987): the surface becomes smooth, and its boundary a smooth curve of its own. Corners, where
              ///< the boundary turns by more than 45 degrees, stay.
};

inline constexpr int kDefaultSubdivisionRounds = 2;
inline constexpr int kMaxSubdivisionRounds = 5;

/// Which fine mesh belongs to a coarse one.
struct SubdivisionSpec {
  int rounds = kDefaultSubdivisionRounds;  ///< 0 to kMaxSubdivisionRounds
  SubdivisionRule rule = SubdivisionRule::kMidpoint;
  bool operator==(const SubdivisionSpec&) const = default;
};

/// Splits every edge in 2^rounds: rounds = 2 gives the paper's 16 faces per face (749 -> 11,393 vertices). Material
/// coordinates are split along, so that seams stay seams. O(F 4^rounds).
/// With Loop's rule material coordinates are split in the middle all the same: the charts stay the polygons that they
/// were, so that an atlas stays one (smoothing would pull the charts' borders inwards, and apart at seams), and every
/// fine face has its share of its coarse face's cloth. `barycentric` is linear too: upsample() gives the coarse
/// surface.
Subdivision subdivide(const Topology& coarse, int rounds = kDefaultSubdivisionRounds,
                      SubdivisionRule rule = SubdivisionRule::kMidpoint);

/// The same. Throws kInvalidArgument for rounds out of range.
Subdivision subdivide(const Topology& coarse, const SubdivisionSpec& spec);

/// How the fine mesh was made from the coarse one, for files that do not say it; nothing if subdivide() does not give
/// it, bit by bit. Builds at most one mesh per rule.
std::optional<SubdivisionSpec> find_subdivision(const Topology& coarse, const Topology& fine);

/// Barycentric upsampling of a coarse frame: (V_coarse x 3) -> (V_fine x 3). The surface stays the same set of points.
Positions upsample(const Subdivision& subdivision, const Faces& coarse_faces, const Positions& coarse_positions);
/// The same into memory that is reused.
void upsample(const Subdivision& subdivision, const Faces& coarse_faces, const Positions& coarse_positions,
              Positions& fine);

}  // namespace pleat
