#include "common/frame/representation_messages.hpp"

#include <algorithm>
#include <string>

#include "common/base/error.hpp"

namespace pleat {
namespace {

/// The form of messages from before there were representations.
template <typename Message>
v1::Representation published_image(const Message& message, const v1::Normalization& normalization) {
  v1::Representation representation;
  v1::GeometryImage& image = *representation.mutable_geometry_image();
  image.set_width(message.coarse_width());
  image.set_height(message.coarse_height());
  image.set_scale(message.scale());
  const auto &minimum = normalization.minimum(), &maximum = normalization.maximum();
  if (minimum.size() != maximum.size()) {
    throw_invalid_argument("normalization: " + std::to_string(minimum.size()) + " minima and " +
                           std::to_string(maximum.size()) + " maxima");
  }
  v1::ChannelRanges& input = *representation.mutable_input();
  for (int c = 0; c < minimum.size(); ++c) {
    input.add_offset(minimum[c]);
    input.add_scale(maximum[c] - minimum[c]);
  }
  *representation.mutable_output() = input;
  return representation;
}

}  // namespace

v1::Representation representation_of(const v1::ConversionSetup& setup) {
  if (setup.has_representation()) return setup.representation();
  v1::Representation representation = published_image(setup, setup.normalization());
  representation.mutable_geometry_image()->set_texels_per_fine_vertex(
      static_cast<double>(setup.texels_per_fine_vertex()));
  if (setup.has_subdivision_rounds()) representation.set_subdivision_rounds(setup.subdivision_rounds());
  return representation;
}

v1::Representation representation_of(const v1::ModelDescription& model) {
  return model.has_representation() ? model.representation() : published_image(model, model.normalization());
}

v1::SubdivisionRule to_message(SubdivisionRule rule) {
  return rule == SubdivisionRule::kMidpoint ? v1::SUBDIVISION_RULE_MIDPOINT : v1::SUBDIVISION_RULE_LOOP;
}

void set_subdivision(const SubdivisionSpec& spec, v1::Representation* message) {
  message->set_subdivision_rounds(static_cast<std::uint32_t>(spec.rounds));
  message->set_subdivision_rule(to_message(spec.rule));
}

SubdivisionSpec subdivision_from(std::optional<std::uint32_t> rounds, v1::SubdivisionRule rule) {
  SubdivisionSpec spec;
  if (rounds) spec.rounds = static_cast<int>(std::min<std::uint32_t>(*rounds, kMaxSubdivisionRounds + 1));
  if (rule == v1::SUBDIVISION_RULE_LOOP) spec.rule = SubdivisionRule::kSmooth;
  return spec;
}

}  // namespace pleat
