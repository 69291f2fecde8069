// The built page of services/presentation/viewer, inside the library.
#pragma once

#include <string_view>

namespace pleat::presentation {

/// UTF-8 text of viewer.html; the markers that html.cpp replaces are in it once each.
std::string_view viewer_template();

}  // namespace pleat::presentation
