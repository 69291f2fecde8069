#include "services/conversion/spec_messages.hpp"

#include <algorithm>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/representation_messages.hpp"

namespace pleat::conversion {
namespace {

int extent(std::uint32_t value) { return static_cast<int>(std::min(value, 1u << 20)); }

GeometryImageSpec image_from(const v1::GeometryImage& message, std::int64_t max_texels) {
  GeometryImageSpec spec;
  switch (message.layout()) {
    case v1::GeometryImage::LAYOUT_PUBLISHED:
      spec.layout = ImageLayout::kPublished;
      break;
    case v1::GeometryImage::LAYOUT_DETAIL:
      spec.layout = ImageLayout::kDetail;
      break;
    case v1::GeometryImage::LAYOUT_POSITIONS:
      spec.layout = ImageLayout::kPositions;
      break;
    default:
      throw_invalid_argument("representation.geometry_image.layout: unknown value " +
                             std::to_string(static_cast<int>(message.layout())));
  }
  spec.base = message.base() == v1::GeometryImage::BASE_TEXELS ? DetailBase::kTexels : DetailBase::kVertices;
  spec.units =
      message.units() == v1::GeometryImage::UNITS_COARSE_EDGES ? DetailUnits::kCoarseEdges : DetailUnits::kMetres;
  spec.image.coarse_width = extent(message.width());
  spec.image.coarse_height = extent(message.height());
  if (message.scale() != 0) spec.image.scale = extent(message.scale());
  if (message.texels_per_fine_vertex() != 0) spec.image.texels_per_fine_vertex = message.texels_per_fine_vertex();
  spec.image.max_fine_texels = max_texels;
  return spec;
}

VertexFeatureSpec features_from(const v1::VertexFeatures& message) {
  VertexFeatureSpec spec;
  switch (message.rotation()) {
    case v1::VertexFeatures::ROTATION_LOGARITHM:
      spec.rotation = RotationCode::kLogarithm;
      break;
    case v1::VertexFeatures::ROTATION_QUATERNION:
      spec.rotation = RotationCode::kQuaternion;
      break;
    default:
      throw_invalid_argument("representation.vertex_features.rotation: unknown value " +
                             std::to_string(static_cast<int>(message.rotation())));
  }
  switch (message.answer()) {
    case v1::VertexFeatures::ANSWER_GRADIENTS:
      spec.answer = AnswerKind::kGradients;
      break;
    case v1::VertexFeatures::ANSWER_FEATURES:
      spec.answer = AnswerKind::kFeatures;
      break;
    case v1::VertexFeatures::ANSWER_FEATURES_ALONE:
      spec.answer = AnswerKind::kFeaturesAlone;
      break;
    default:
      throw_invalid_argument("representation.vertex_features.answer: unknown value " +
                             std::to_string(static_cast<int>(message.answer())));
  }
  spec.fixed_axes = message.fixed_axes();
  spec.obstacles = message.obstacles();
  if (message.has_passes()) spec.passes = extent(message.passes());
  if (message.anchor_weight() != 0) spec.anchor_weight = message.anchor_weight();
  return spec;
}

}  // namespace

RepresentationSpec spec_from(const v1::Representation& message, std::int64_t max_texels) {
  RepresentationSpec spec;
  switch (message.kind_case()) {
    case v1::Representation::kGeometryImage:
    case v1::Representation::KIND_NOT_SET:
      spec.kind = image_from(message.geometry_image(), max_texels);
      break;
    case v1::Representation::kVertexFeatures:
      spec.kind = features_from(message.vertex_features());
      break;
  }
  spec.subdivision = subdivision_from(message);
  if (spec.subdivision.rounds > kMaxSubdivisionRounds) {
    throw_invalid_argument("representation.subdivision_rounds: at most " + std::to_string(kMaxSubdivisionRounds) +
                           ", not " + std::to_string(message.subdivision_rounds()));
  }
  const auto frames = [](std::uint32_t value, const char* field) {
    if (value > static_cast<std::uint32_t>(kMaxWindow)) {
      throw_invalid_argument("representation." + std::string(field) + ": at most " + std::to_string(kMaxWindow) +
                             " frames, not " + std::to_string(value));
    }
    return std::max(1, static_cast<int>(value));
  };
  spec.window = frames(message.window(), "window");
  spec.window_stride = frames(message.window_stride(), "window_stride");
  return spec;
}

ChannelRanges ranges_from(const v1::ChannelRanges& message, std::size_t channels, const std::string& field) {
  ChannelRanges ranges;
  ranges.offset.assign(message.offset().begin(), message.offset().end());
  ranges.scale.assign(message.scale().begin(), message.scale().end());
  ranges.limit = message.limit();
  check_ranges(ranges, channels, field);
  return ranges;
}

}  // namespace pleat::conversion
