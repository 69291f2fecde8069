// Geometry images: a cloth frame as an image of features in material space, and back ([MFSR] section 4.3, [MFSR-S]
// eq. 1-4). docs/conversion.md explains the method.
//
// Texel convention. Fine texel (i, j), column i and row j, has its centre at
//   u = u_min + i (u_max - u_min) / (W - 1),   v = v_min + j (v_max - v_min) / (H - 1),
// so that the outermost centres lie on the edges of the material bounding box and no vertex is outside the grid.
// Row 0 has the smallest v. Coarse texel (I, J) is the block of `scale` x `scale` fine texels from (I scale, J scale),
// and its centre is the centre of that block. With spec.seam_reach the grid goes on beyond the box where a seam lies.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "common/features/frame_features.hpp"
#include "common/frame/frame.hpp"
#include "common/mesh/mesh.hpp"
#include "services/conversion/geometry_image/image_spec.hpp"
#include "services/conversion/vertex_reads.hpp"

namespace pleat::conversion {

/// A coarse frame as an image, with the alignment that its fine frame needs.
struct CoarseImage {
  Tensor image;  ///< (9, h, w)
  RigidTransform transform;
};

/// One texel as a combination of three vertices; padding repeats the texel whose value it shows.
struct TexelTaps {
  std::array<std::uint32_t, 3> vertex;
  std::array<float, 3> weight;
};

/// A texel beyond a seam, in the coarse triangle that is there.
struct SeamTexel {
  std::uint32_t texel;
  std::array<float, 3> weight;
};

/// The sparse maps between the meshes of one session and their images. Every const member may be called from several
/// threads; those that write into the caller's memory take none of their own once they have run.
class ImageMap {
 public:
  /// coarse, fine: both with material coordinates in the same space; fine need not be a subdivision of coarse. The
  /// coordinates may be in metres or normalised, in several charts, rotated or mirrored, with seams, holes and faces
  /// without area.
  /// Throws kInvalidArgument (unusable topology; material coordinates absent, folded or overlapping; a spec out of
  /// range; an image too small for a chart), kResourceExhausted (more than spec.max_fine_texels).
  ImageMap(const Topology& coarse, const Topology& fine, const ImageSpec& spec = {});
  ~ImageMap();
  ImageMap(ImageMap&&) noexcept;
  ImageMap& operator=(ImageMap&&) noexcept;

  const ImageSpec& spec() const;
  int coarse_width() const;
  int coarse_height() const;
  int fine_width() const;
  int fine_height() const;

  /// 1 where a texel holds a value of its own, 0 where it is padding; (h w) and (H W), row-major. A coarse texel is
  /// valid if its centre is in a chart, or at most spec.seam_reach texels beyond a seam of one; a fine texel if it is
  /// in a chart, or a vertex at the rim of one reads it.
  const std::vector<std::uint8_t>& coarse_mask() const;
  const std::vector<std::uint8_t>& fine_mask() const;

  /// The rigid alignment of a frame: kabsch(coarse positions, coarse rest positions).
  RigidTransform align(const Positions& coarse_positions) const;

  /// Features of a coarse frame as an image (9, h, w). An empty frame.velocities counts as zero. O(V + texels).
  /// Throws kInvalidArgument for a wrong vertex count or values that are not finite.
  CoarseImage coarse_image(const Frame& coarse) const;
  /// The same with a given alignment, into a tensor that is reused.
  void coarse_image(const Frame& coarse, const RigidTransform& transform, Tensor& image) const;

  /// The same into memory of 9 h w values.
  void coarse_image(const Frame& coarse, const RigidTransform& transform, float* planes) const;

  /// Features of a fine frame as an image (9, H, W): the training target. The first call of kFitted factorises
  /// (about 0.3 s for 240 x 160 texels).
  Tensor fine_image(const Frame& fine, const RigidTransform& transform) const;
  void fine_image(const Frame& fine, const RigidTransform& transform, Tensor& image) const;

  /// Any values of the fine vertices (V_fine x 3) as an image, in the same way: 3 H W values.
  void fine_planes(const Positions& values, float* planes) const;

  /// Of each coarse texel: its chart, kNone for padding; and the valid texel whose value it shows, itself if it is one.
  const std::vector<std::uint32_t>& coarse_charts() const;
  const std::vector<std::uint32_t>& coarse_shown() const;

  /// How a texel is sampled: (h w) of the coarse and (H W) of the fine mesh.
  const std::vector<TexelTaps>& coarse_taps() const;
  const std::vector<TexelTaps>& fine_taps() const;

  /// 1 for coarse texels that show what is beyond a seam, (h w); and how far they are from each other along u and v,
  /// metres of the material.
  const std::vector<std::uint8_t>& coarse_beyond_seams() const;
  const Eigen::Vector2d& coarse_step() const;

  /// The fine texels beyond seams: no vertex reads them.
  const std::vector<SeamTexel>& fine_beyond_seams() const;

  /// Fine positions (V_fine x 3) from the displacement channels by bilinear reads over valid texels. A vertex with
  /// several material coordinates gets the mean of its charts; a vertex that no face uses moves with the alignment.
  /// image: (C, H, W) with C >= 3. Throws kInvalidArgument for another shape or values that are not finite.
  Positions to_mesh(const Tensor& image, const RigidTransform& transform) const;
  void to_mesh(const Tensor& image, const RigidTransform& transform, Positions& positions) const;

  /// What to_mesh reads: displacements in the frame of the alignment, to which it adds the rest positions.
  const VertexReads& vertex_reads() const;

 private:
  struct Maps;
  std::unique_ptr<Maps> maps_;
};

}  // namespace pleat::conversion
