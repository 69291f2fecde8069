#include "common/frame/detail.hpp"

#include "common/base/error.hpp"

namespace pleat {

v1::Detail checked_detail(v1::Detail detail, std::string_view model, const std::string& field) {
  if (detail == v1::DETAIL_UNSPECIFIED) return default_detail(model);
  if (!v1::Detail_IsValid(detail)) {
    throw_invalid_argument(field + ": unknown value " + std::to_string(static_cast<int>(detail)));
  }
  return detail;
}

std::vector<std::string> stage_names(v1::Detail detail) {
  std::vector<std::string> names;
  if (uses_network(detail)) names = {"to_image", "superres", "to_mesh"};
  if (uses_fold(detail)) names.push_back("fold");
  if (detail == v1::DETAIL_NONE) names.push_back("upsampling");
  if (detail == v1::DETAIL_TRACKED || detail == v1::DETAIL_FREE) names.push_back("simulation.fine");
  names.push_back("refinement");
  return names;
}

std::string_view name_of(v1::Detail detail) {
  switch (detail) {
    case v1::DETAIL_NETWORK:
      return "network";
    case v1::DETAIL_FOLD:
      return "fold";
    case v1::DETAIL_BOTH:
      return "both";
    case v1::DETAIL_NONE:
      return "none";
    case v1::DETAIL_TRACKED:
      return "tracked";
    case v1::DETAIL_FREE:
      return "free";
    case v1::DETAIL_COARSE:
      return "coarse";
    default:
      return "default";
  }
}

v1::Detail detail_named(std::string_view name) {
  for (const v1::Detail detail : {v1::DETAIL_NETWORK, v1::DETAIL_FOLD, v1::DETAIL_BOTH, v1::DETAIL_NONE,
                                  v1::DETAIL_TRACKED, v1::DETAIL_FREE, v1::DETAIL_COARSE}) {
    if (name_of(detail) == name) return detail;
  }
  return v1::DETAIL_UNSPECIFIED;
}

}  // namespace pleat
