// TS-ACAP features of a frame: rotation and stretch of every one-ring (docs/vertex-features.md).
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "services/conversion/vertex_features/rotation_labels.hpp"

namespace pleat::conversion {

/// The features of one frame, and memory that the next one reuses.
struct ExtractedFrame {
  std::vector<float> values;   ///< (C x V) planes: rotation, then S's upper triangle by rows
  std::vector<Float4> labels;  ///< (V) the rotations' names: what the next frame is made continuous with
  LabelReport report;
  std::vector<Float4> positions, rotations;  ///< scratch
};

/// Rotation channels of a logarithm v: the entries (0,1), (0,2), (1,2) of [v]x, that is -v_z, v_y, -v_x. Of a
/// quaternion: w, x, y, z. The rest mesh has v = 0 (q = 1) and S = I.
class FeatureExtractor {
 public:
  FeatureExtractor(std::shared_ptr<const OneRings> rings, RotationCode code, float temporal_weight = 0.1f);

  RotationCode code() const { return code_; }
  const OneRings& rings() const { return *rings_; }
  /// 9 or 10.
  int channels() const { return rotation_channels(code_) + 6; }

  /// Features of R_y(-heading) positions. previous: the labels of the frame before, empty for the first one.
  /// Throws kInvalidArgument as load_positions() does. The same input gives the same bits.
  void extract(const Positions& positions, float heading, std::span<const Float4> previous,
               ExtractedFrame& frame) const;

 private:
  std::shared_ptr<const OneRings> rings_;
  RotationCode code_;
  RotationLabels labels_;
};

/// "rotation_xy" (or "rotation_w") ... "stretch_zz": (9) or (10).
std::vector<std::string> feature_channel_names(RotationCode code);

/// T = R S from features, values: (C x V) planes of any finite numbers, denormalised. field is resized to V.
void gradients_from_features(RotationCode code, std::span<const float> values, GradientField& field);

/// The deformation gradients themselves as channels. A rest mesh that lies in a plane determines two columns only:
/// T a, T b for the axes a, b of that plane (6); any other mesh gets T by rows (9).
class GradientChannels {
 public:
  explicit GradientChannels(const Positions& rest_positions);

  bool planar() const { return axes_.has_value(); }
  int channels() const { return planar() ? 6 : 9; }
  std::vector<std::string> names() const;

  /// values is resized: (C x V) planes.
  void to_planes(const GradientField& field, std::vector<float>& values) const;
  /// values: (C x V) planes. A planar mesh's third column becomes the unit normal of the two. field is resized to V.
  void from_planes(std::span<const float> values, GradientField& field) const;

 private:
  std::optional<Eigen::Matrix3f> axes_;  // columns: a, b, the plane's normal
};

/// Brings singular values of every T into [lowest, highest], the reflection of det T < 0 undone: what a network made up
/// must not tear the mesh.
void clamp_stretch(GradientField& field, float lowest = 0.3f, float highest = 3.0f);

}  // namespace pleat::conversion
