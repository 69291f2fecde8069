// The built page of services/cli/viewer, inside the library.
#pragma once

#include <string_view>

namespace pleat {

/// UTF-8 text of viewer.html; the markers that html.cpp replaces are in it once each.
std::string_view viewer_template();

}  // namespace pleat
