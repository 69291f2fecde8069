// The version of the project, which CMakeLists.txt alone says.
#pragma once

#include <string>

namespace pleat {

/// For example "0.2.0".
std::string version();

}  // namespace pleat
