// What the fine cloth has more than the coarse one, as images over the material coordinates: an engine plays the coarse
// mesh and shows the wrinkles by them.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "services/presentation/export/export.hpp"

namespace pleat::presentation {

/// The places of texels on both meshes, found once.
class DetailMaps {
 public:
  struct Images {
    int size = 0;
    /// (size x size x 3), the upper row (largest v) first. From the coarse surface to the fine one, in the units and
    /// axes of the meshes, not turned with the cloth (object space).
    std::vector<float> displacement;
    /// The same: the fine normal in the coarse mesh's tangent frame, (x, y, z) of -1 to 1 as 0 to 65535. x along
    /// growing u, y along growing v (OpenGL's convention), z along the coarse normal.
    std::vector<std::uint16_t> normal;
  };

  /// input: fine, with its coarse mesh; both have material coordinates that are laid out alike, as a result's have.
  /// Texels beside the cloth get the nearest one of it, kPadding deep, so that smaller images bleed nothing in; others
  /// no displacement and the coarse normal. Throws kInvalidArgument for a size out of range or without material
  /// coordinates. O(size^2).
  DetailMaps(const ExportInput& input, int size);

  static constexpr int kPadding = 8;  ///< texels

  /// The coarse mesh with material coordinates as texture coordinates: the image is [0, 1] x [0, 1].
  const Topology& mesh() const { return mesh_; }

  /// coarse, fine: of one frame. O(size^2).
  Images at(const Positions& coarse, const Positions& fine) const;

 private:
  struct Texel {
    std::uint32_t place = 0;  ///< in the image
    std::uint32_t coarse_face = 0, fine_face = 0;
    float coarse[3] = {}, fine[3] = {};  ///< weights of the corners
  };
  int size_;
  Faces fine_faces_;
  Topology mesh_;
  std::vector<Texel> texels_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> copies_;  ///< texels that take another one's values
};

}  // namespace pleat::presentation
