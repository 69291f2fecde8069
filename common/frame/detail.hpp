// What makes the detail of the fine cloth: a network, the fold step, both, nothing, or a fine simulation.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "pleat/v1/common.pb.h"

namespace pleat {

/// Where nobody says what it should be: a network if a bundle (`model`) is named, else the fold step, which serves any
/// garment.
inline v1::Detail default_detail(std::string_view model) {
  return model.empty() ? v1::DETAIL_FOLD : v1::DETAIL_NETWORK;
}

/// Never DETAIL_UNSPECIFIED, which is the default. Throws kInvalidArgument, naming `field`, for values that are none.
v1::Detail checked_detail(v1::Detail detail, std::string_view model, const std::string& field);

/// Of a checked detail.
inline bool is_simulated(v1::Detail detail) {
  return detail == v1::DETAIL_TRACKED || detail == v1::DETAIL_FREE || detail == v1::DETAIL_COARSE;
}
inline bool uses_network(v1::Detail detail) { return detail == v1::DETAIL_NETWORK || detail == v1::DETAIL_BOTH; }
inline bool uses_fold(v1::Detail detail) { return detail == v1::DETAIL_FOLD || detail == v1::DETAIL_BOTH; }

/// Behind the coarse simulation, in the order of the pipeline: "to_image", "superres", ..., "refinement", which judges
/// alone what is simulated. Of a checked detail.
std::vector<std::string> stage_names(v1::Detail detail);

/// "network", "fold", "both", "none", "tracked", "free", "coarse"; "default" for DETAIL_UNSPECIFIED.
std::string_view name_of(v1::Detail detail);
/// The reverse; DETAIL_UNSPECIFIED for other names.
v1::Detail detail_named(std::string_view name);

}  // namespace pleat
