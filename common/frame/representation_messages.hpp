// Subdivision on the wire, for every room that hands it on.
#pragma once

#include <cstdint>
#include <optional>

#include "common/mesh/subdivision.hpp"
#include "pleat/v1/common.pb.h"

namespace pleat {

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
