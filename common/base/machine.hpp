// What figures were measured with: this build and this machine.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace pleat {

/// The version of the project, for example "0.1.0".
std::string version();

/// The revision that this was built from, 12 digits and a "+" if files had changed; "unknown" outside a git checkout.
std::string git_revision();

/// processor, processors (that this process may use), memory_gib, system.
nlohmann::json machine_info();

}  // namespace pleat
