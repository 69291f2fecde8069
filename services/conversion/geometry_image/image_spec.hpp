// How a geometry image is made.
#pragma once

#include <cstdint>

namespace pleat::conversion {

/// Fine size over coarse size.
inline constexpr int kDefaultScale = 4, kMostScale = 16;
inline constexpr int kMostSeamReach = 64;
/// Weight of the second differences of a fitted fine image.
inline constexpr double kDefaultFitWeight = 5e-5;

enum class FineImageMethod {
  kFitted,   ///< least squares: bilinear reads reproduce the vertices, plus lambda times second differences
  kSampled,  ///< barycentric sampling as published
};

/// Sizes of an image, and how the fine one is made.
struct ImageSpec {
  double texels_per_fine_vertex = 3;  ///< chooses the size where coarse_width is 0
  int coarse_width = 0;       ///< texels on the material bounding box; 0: from texels_per_fine_vertex and the box
  int coarse_height = 0;      ///< texels; set with coarse_width or not at all
  int scale = kDefaultScale;  ///< fine size over coarse size, 1 to kMostScale
  FineImageMethod method = FineImageMethod::kFitted;
  double lambda = kDefaultFitWeight;  ///< weight of the second differences of kFitted, > 0
  /// Coarse texels beyond a seam that show the cloth on its other side; the image is larger by as many where a seam is
  /// at its side. 0: none.
  int seam_reach = 0;
  std::int64_t max_fine_texels = 16ll << 20;  ///< more are refused before anything is built
};

/// Which channels a network reads and answers (docs/conversion.md).
enum class ImageLayout {
  kPublished,  ///< displacement, normal and velocity (9) to the same of the fine mesh (9)
  kDetail,     ///< the cloth in its own axes (17), and where the coarse triangles lie, to detail in those axes (3)
  kPositions,  ///< positions (3) to positions (3)
};

/// Where a detail is added to the coarse surface.
enum class DetailBase {
  kVertices,  ///< at the fine vertices, where it is known exactly
  kTexels,    ///< at the texels: the surface is sampled there, and read with the detail
};

/// In what a detail layout counts lengths and velocities.
enum class DetailUnits {
  kMetres,       ///< metres, m/s
  kCoarseEdges,  ///< the coarse mesh's mean edge at rest, h, and sqrt(g h): of no mesh in particular
};

struct GeometryImageSpec {
  ImageLayout layout = ImageLayout::kPublished;
  DetailBase base = DetailBase::kVertices;   ///< of kDetail
  DetailUnits units = DetailUnits::kMetres;  ///< of kDetail
  ImageSpec image;
};

}  // namespace pleat::conversion
