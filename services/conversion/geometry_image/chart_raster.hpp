// Which texel centre lies where on the charts of a mesh, and how vertices read texels back. Internal to this room.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/mesh/connectivity.hpp"
#include "common/mesh/mesh.hpp"

namespace pleat::conversion {

/// A regular grid of texel centres in material space.
struct TexelGrid {
  int width = 0, height = 0;
  double u0 = 0, v0 = 0;  ///< centre of texel (0, 0), metres
  double du = 0, dv = 0;  ///< distance of neighbouring centres, metres

  std::size_t size() const { return static_cast<std::size_t>(width) * static_cast<std::size_t>(height); }
};

/// Where a texel gets its value: a point of a face.
struct TexelSource {
  std::uint32_t face = kNone;  ///< kNone: padding
  std::array<float, 3> weight{};
};

/// A vertex of the material coordinates as a combination of up to four texels. Unused entries have weight 0.
struct TexelRead {
  std::array<std::uint32_t, 4> texel{};
  std::array<float, 4> weight{};
};

struct ChartRaster {
  std::vector<TexelSource> sources;      ///< one per texel
  std::vector<std::uint32_t> chart;      ///< one per texel; kNone for padding
  std::vector<std::uint8_t> is_rim;      ///< one per texel: valid only because a vertex at a rim reads it
  std::vector<TexelRead> reads;          ///< one per material coordinate; empty without rims
  std::vector<std::uint32_t> padded_by;  ///< one per texel: the valid texel whose value it shows; itself if valid
};

/// Throws kInvalidArgument unless the material coordinates can be rasterised: they are there, some face has area in
/// them, and no chart is folded (faces of both orientations). Charts may be rotated and mirrored; faces without area
/// are allowed and cover no texel. Charts are the connected components of uv_faces.
void check_charts(const Topology& topology, const std::string& name);

/// Metres per unit of the material coordinates along u and v: the medians over the faces, weighted by area, of how long
/// a unit is on the rest mesh. Exactly 1 and 1 if both are within 10 % of it: then the coordinates are in metres.
/// The topology must pass check_charts.
Eigen::Vector2d recover_material_scale(const Topology& topology);

/// Rasterises the faces in material space. A centre on an edge belongs to the face in which it is deepest, then to the
/// smallest face index. with_rims: texels outside the charts that vertices at their rims read also become valid, with
/// the value at the nearest point of a face beside that vertex; and `reads` is filled. A vertex reads texels of its own
/// chart only. The topology must pass check_charts. Throws kInvalidArgument if two faces overlap in a texel, no texel
/// is valid, or (with_rims) a chart has none. O(texels + faces + covered texels).
ChartRaster rasterise_charts(const Topology& topology, const TexelGrid& grid, bool with_rims, const std::string& name);

/// The valid texel that is nearest to each, by Euclidean distance in texels; itself if it is one. Some must be.
/// O(texels), however far apart the charts are.
std::vector<std::uint32_t> nearest_valid(const TexelGrid& grid, const std::vector<TexelSource>& sources);

}  // namespace pleat::conversion
