// The representation of a network that sees one-rings: features of vertices in, offsets and gradients out.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/pool.hpp"
#include "services/conversion/representation.hpp"
#include "services/conversion/vertex_features/coordinates.hpp"
#include "services/conversion/vertex_features/extraction.hpp"

namespace pleat::conversion {

/// The places of all tensors are the F coarse faces. Input (3 C, 1, F): the C features of each corner, rotation and
/// stretch of its one-ring, position about the centroid (m) and velocity (m/s), in the axes of the newest frame's
/// heading; with spec().obstacles also how near the nearest obstacle of the newest frame is, 1 at its surface and 0
/// from two mean coarse edges on, and the direction away from it, as long as that. Answer (C', s, s F): a square of s x
/// s values for each face, the first ones for the fine vertices in it (lattice order), the others padding. By
/// AnswerKind:
///   kGradients      the fine vertex's offset from the upsampled coarse surface (m), and what its deformation gradient
///                   has more than that surface's, 6 channels where the fine rest mesh is flat, else 9. Decoding adds
///                   the offsets, then corrects the positions until they have the gradients, the coarse vertices as
///                   soft anchors. Zeros are the upsampled surface.
///   kFeatures       the same offset, and rotation and stretch (9 or 10) themselves. Decoded the same way.
///   kFeaturesAlone  rotation and stretch. Decoding solves for the positions and moves them so that the mean of the
///                   coarse vertices in them is that of the coarse mesh; `passes` correct what one-rings average away.
/// Rotations have the names of a first frame, whatever was before. Where faces meet, their answers are averaged; of
/// kFeaturesAlone each vertex has one place, in the first of its faces. The alignment is the turn about the vertical
/// axis and the centroid.
class VertexRepresentation final : public Representation {
 public:
  /// Throws kInvalidArgument, naming the vertex, for a subdivision without parents and for one-rings without a shape.
  VertexRepresentation(const Topology& coarse, Subdivision subdivision, const RepresentationSpec& spec);

  const RepresentationSpec& spec() const override { return spec_; }
  const Topology& coarse() const override { return coarse_; }
  const Subdivision& subdivision() const override { return subdivision_; }
  std::vector<std::int64_t> input_shape() const override;
  std::vector<std::int64_t> answer_shape() const override;
  std::vector<std::string> input_channels() const override;
  std::vector<std::string> answer_channels() const override;
  const Tensor& constants() const override { return constants_; }
  RigidTransform align(const Positions& coarse) const override;
  void encode(std::span<const Frame> frames, const RigidTransform& alignment, Tensor& input,
              ObstacleField* obstacles) const override;
  bool reads_obstacles() const override { return features().obstacles; }
  void target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const override;
  void decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
              Positions& fine) const override;
  const std::vector<std::uint8_t>& input_mask() const override { return input_mask_; }
  const std::vector<std::uint8_t>& answer_mask() const override { return answer_mask_; }
  const VertexReads& reads() const override { return reads_; }
  void answer_axes(const Positions& coarse, const RigidTransform& alignment, Tensor& axes) const override;
  void base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const override;
  bool fits_half() const override { return features().answer == AnswerKind::kGradients; }
  std::size_t size() const override;

 private:
  struct Scratch {
    ExtractedFrame extracted;
    std::vector<Float4> labels;       ///< of the frame before
    std::vector<float> features;      ///< (C, V_coarse)
    std::vector<float> base, planes;  ///< (D, V_fine)
    ExtractedFrame fine;
    std::vector<Float4> aligned;  ///< (V_fine)
    GradientField field;
    CoordinateScratch coordinates;
  };
  const VertexFeatureSpec& features() const { return std::get<VertexFeatureSpec>(spec_.kind); }
  std::size_t faces() const { return static_cast<std::size_t>(coarse_.face_count()); }
  std::size_t answer_places() const { return answer_mask_.size(); }
  int corner_channels() const { return extractor_.channels() + 6 + (features().obstacles ? 4 : 0); }
  void make_places();
  void make_constants();
  void check_coarse(const Positions& coarse) const;
  /// (C, V_coarse) to scratch.features.
  void vertex_features(const Frame& frame, const RigidTransform& alignment, bool first, Scratch& scratch) const;
  /// (4, V_coarse) to `to`: nearness and direction of the nearest obstacle.
  void obstacle_features(const Frame& frame, const RigidTransform& alignment, ObstacleField* obstacles,
                         float* to) const;
  /// D channels of the gradients of fine positions in the alignment's axes.
  void gradient_planes(const Positions& aligned, Scratch& scratch, std::vector<float>& planes) const;
  bool has_offsets() const { return features().answer != AnswerKind::kFeaturesAlone; }
  int shape_channels() const;
  /// Channels of the answer from the first one behind the offsets on, averaged at fine vertices: scratch.planes, or
  /// with `add` on top of what is there.
  void read_planes(const Tensor& answer, bool add, Scratch& scratch) const;
  /// Averages of a channel of the answer at fine vertex v.
  float read(const float* channel, std::size_t v) const;

  RepresentationSpec spec_;
  Topology coarse_;
  Subdivision subdivision_;
  FeatureExtractor extractor_;
  std::shared_ptr<const OneRings> fine_rings_;
  FeatureExtractor fine_extractor_;
  GradientChannels gradient_channels_;
  CoordinateSolver solver_;
  std::vector<std::uint32_t> vertex_at_;  ///< (s, s F): the fine vertex at a place, kNone for padding
  VertexReads reads_;
  std::vector<std::uint8_t> input_mask_, answer_mask_;
  Tensor constants_;
  double reach_ = 0;  ///< m, from where on an obstacle is not felt
  mutable Pool<Scratch> scratch_;
};

}  // namespace pleat::conversion
