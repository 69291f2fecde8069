// Geometry images as a representation: docs/conversion.md has the layouts.
#pragma once

#include "services/conversion/geometry_image/image_map.hpp"
#include "services/conversion/representation.hpp"

namespace pleat::conversion {

/// What the layouts share: meshes, maps, shapes. The published layout is one that reads and answers all nine channels
/// in the alignment's axes.
class GeometryImage : public Representation {
 public:
  /// Throws as make_representation().
  GeometryImage(const Topology& coarse, Subdivision subdivision, const RepresentationSpec& spec);

  const RepresentationSpec& spec() const override { return spec_; }
  const Topology& coarse() const override { return coarse_; }
  const Subdivision& subdivision() const override { return subdivision_; }
  std::vector<std::int64_t> input_shape() const override;
  std::vector<std::int64_t> answer_shape() const override;
  std::vector<std::string> input_channels() const override;
  std::vector<std::string> answer_channels() const override;
  const Tensor& constants() const override { return constants_; }
  RigidTransform align(const Positions& coarse) const override { return map_.align(coarse); }
  void encode(std::span<const Frame> frames, const RigidTransform& alignment, Tensor& input,
              ObstacleField* obstacles) const override;
  bool reads_obstacles() const override { return false; }
  void target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const override;
  void decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
              Positions& fine) const override;
  const std::vector<std::uint8_t>& input_mask() const override { return map_.coarse_mask(); }
  const std::vector<std::uint8_t>& answer_mask() const override { return map_.fine_mask(); }
  const VertexReads& reads() const override { return map_.vertex_reads(); }
  void answer_axes(const Positions& coarse, const RigidTransform& alignment, Tensor& axes) const override;
  void base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const override;
  bool fits_half() const override { return false; }
  std::size_t size() const override;

  const ImageMap& map() const { return map_; }

 protected:
  const GeometryImageSpec& image_spec() const { return std::get<GeometryImageSpec>(spec_.kind); }
  std::size_t coarse_texels() const { return map_.coarse_mask().size(); }
  std::size_t fine_texels() const { return map_.fine_mask().size(); }
  /// One frame in its channels: input_shape() values.
  virtual void encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const;
  /// Throws kInvalidArgument unless answer is (channels, H, W), with as many values.
  void check_answer(const Tensor& answer, std::int64_t channels) const;
  void shape_answer(Tensor& answer) const;

  RepresentationSpec spec_;
  Topology coarse_;
  Subdivision subdivision_;
  ImageMap map_;
  Tensor constants_;
};

/// Positions in the alignment's axes, to positions (metres).
class PositionImage final : public GeometryImage {
 public:
  using GeometryImage::GeometryImage;
  std::vector<std::string> input_channels() const override;
  std::vector<std::string> answer_channels() const override { return input_channels(); }
  void target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment, Tensor& answer) const override;
  void decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
              Positions& fine) const override;
  void base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const override;

 protected:
  void encode_frame(const Frame& frame, const RigidTransform& alignment, float* planes) const override;
};

}  // namespace pleat::conversion
