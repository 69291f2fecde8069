// Representations and subdivision on the wire, for every room that hands them on.
#pragma once

#include <cstdint>
#include <optional>

#include "common/mesh/subdivision.hpp"
#include "pleat/v1/conversion.pb.h"
#include "pleat/v1/superres.pb.h"

namespace pleat {

/// What a setup asks for: its representation, or the same made of the older fields. Throws kInvalidArgument if those
/// contradict each other.
v1::Representation representation_of(const v1::ConversionSetup& setup);
/// How conversion has to be set up for a bundle, in the same way.
v1::Representation representation_of(const v1::ModelDescription& model);

v1::SubdivisionRule to_message(SubdivisionRule rule);
/// Unset rounds are the default; rounds out of range stay so, for subdivide() to refuse.
SubdivisionSpec subdivision_from(std::optional<std::uint32_t> rounds, v1::SubdivisionRule rule);
/// Of a message with subdivision_rounds and subdivision_rule.
template <typename Message>
SubdivisionSpec subdivision_from(const Message& message) {
  return subdivision_from(message.has_subdivision_rounds() ? std::optional(message.subdivision_rounds()) : std::nullopt,
                          message.subdivision_rule());
}
/// A fine mesh of the caller's choice instead of the bundle's own.
void set_subdivision(const SubdivisionSpec& spec, v1::Representation* message);

}  // namespace pleat
