#include "common/frame/representation_messages.hpp"

#include <algorithm>

namespace pleat {
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
