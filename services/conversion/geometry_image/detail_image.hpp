// The layout that sees the cloth in its own axes and answers what the fine mesh adds to the coarse one.
#pragma once

#include <memory>
#include <vector>

#include "common/base/pool.hpp"
#include "services/conversion/geometry_image/cloth_axes.hpp"
#include "services/conversion/geometry_image/geometry_image.hpp"

namespace pleat::conversion {

/// What one unit of each channel is, in metres, m/s or nothing.
struct DetailUnit {
  std::vector<float> inputs;   ///< of cloth_channel_names()
  std::vector<float> answers;  ///< all the same
};
/// Throws kInvalidArgument for kCoarseEdges of a mesh whose edges have no length.
DetailUnit detail_unit(const Topology& coarse, DetailUnits units);

/// Input: the channels of cloth_channel_names() at each coarse texel. Answer: three channels, at each fine texel the
/// vector from the coarse surface to the fine one along the texel's axes (enlarged bilinearly), metres. Constants: at
/// each coarse texel the largest and the second largest barycentric weight in the coarse triangles, at each of its fine
/// texels, but at most at 4 x 4 places, brought to about -1 to 1: (2 min(scale, 4)^2, h, w).
/// With DetailUnits::kCoarseEdges what is said in metres is in coarse edges h, and velocities are in sqrt(g h).
class DetailImage final : public GeometryImage {
 public:
  /// The subdivision needs its parents.
  DetailImage(const Topology& coarse, Subdivision subdivision, const RepresentationSpec& spec);

  std::vector<std::string> input_channels() const override { return cloth_channel_names(); }
  std::vector<std::string> answer_channels() const override;
  const VertexReads& reads() const override { return reads_; }
  bool fits_half() const override { return true; }
  void target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const override;
  void decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
              Positions& fine) const override;
  void answer_axes(const Positions& coarse, const RigidTransform& alignment, Tensor& axes) const override;
  void base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const override;

 protected:
  void encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const override;

 private:
  struct Scratch {
    std::vector<float> image, axes, turned, coarse;
    ClothAxes::Scratch positions;
    EnlargedAxes::Scratch row;
  };
  void make_constants(const VertexReads& texel_corners);
  void axes_of(const Positions& coarse, const RigidTransform& alignment, Scratch& scratch, float* axes) const;
  /// The coarse surface where the detail is added, in the mesh's own axes.
  void base_positions(const Positions& coarse, Scratch& scratch, Positions& fine) const;
  void check_coarse(const Positions& coarse) const;

  DetailUnit unit_;
  VertexReads reads_;         ///< of an answer: metres
  VertexReads fine_corners_;  ///< each fine vertex as a combination of coarse ones
  std::vector<float> rest_;   ///< at the coarse texels (3, h, w)
  std::unique_ptr<ClothAxes> cloth_axes_;
  EnlargedAxes enlarged_;
  mutable Pool<Scratch> scratch_;
};

}  // namespace pleat::conversion
