#include "services/conversion/representation.hpp"

#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "services/conversion/geometry_image/detail_image.hpp"
#include "services/conversion/vertex_features/vertex_representation.hpp"

namespace pleat::conversion {

namespace {

AnswerForm form_of(const GeometryImageSpec& spec, int) {
  AnswerForm form;
  form.scale = spec.image.scale;
  form.detail = form.own_axes = spec.layout == ImageLayout::kDetail;
  form.first_three = true;
  form.block = form.scale * form.scale;
  if (spec.image.coarse_width > 0) form.input_size = {{spec.image.coarse_height, spec.image.coarse_width}};
  return form;
}

AnswerForm form_of(const VertexFeatureSpec& spec, int rounds) {
  AnswerForm form;
  form.scale = patch_side(rounds);
  form.block = patch_vertices(rounds);
  form.detail = spec.answer == AnswerKind::kGradients;
  return form;
}

}  // namespace

AnswerForm answer_form(const RepresentationSpec& spec) {
  return std::visit([&](const auto& kind) { return form_of(kind, spec.subdivision.rounds); }, spec.kind);
}

std::unique_ptr<const Representation> make_representation(const Topology& coarse, const RepresentationSpec& spec,
                                                          const Topology* fine) {
  if (spec.window < 1 || spec.window > kMaxWindow) {
    throw_invalid_argument("representation: a window of 1 to " + std::to_string(kMaxWindow) + " frames, not " +
                           std::to_string(spec.window));
  }
  if (spec.window_stride < 1 || spec.window_stride > kMaxWindow) {
    throw_invalid_argument("representation: a stride of 1 to " + std::to_string(kMaxWindow) + " frames, not " +
                           std::to_string(spec.window_stride));
  }
  Subdivision subdivision;
  if (fine != nullptr) {
    subdivision.fine = *fine;
  } else {
    validate_topology(coarse, "coarse mesh");
    subdivision = subdivide(coarse, spec.subdivision);
  }
  if (std::holds_alternative<VertexFeatureSpec>(spec.kind)) {
    return std::make_unique<VertexRepresentation>(coarse, std::move(subdivision), spec);
  }
  switch (std::get<GeometryImageSpec>(spec.kind).layout) {
    case ImageLayout::kPublished:
      return std::make_unique<GeometryImage>(coarse, std::move(subdivision), spec);
    case ImageLayout::kDetail:
      return std::make_unique<DetailImage>(coarse, std::move(subdivision), spec);
    case ImageLayout::kPositions:
      return std::make_unique<PositionImage>(coarse, std::move(subdivision), spec);
  }
  throw_internal("representation: an unknown layout");
}

}  // namespace pleat::conversion
