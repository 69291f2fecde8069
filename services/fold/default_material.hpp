// The material of a cloth that nobody has said anything of.
#pragma once

#include <string_view>

namespace pleat::fold {

/// The text of deploy/materials/gray-interlock.json, as it was when this was built.
std::string_view default_material_json();

}  // namespace pleat::fold
