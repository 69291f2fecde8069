// What figures were measured with: this build and this machine.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "common/base/version.hpp"

namespace pleat {

/// The revision that this was built from, 12 digits and a "+" if files had changed; "unknown" outside a git checkout.
std::string git_revision();

/// processor, processors (that this process may use), memory_gib, system.
nlohmann::json machine_info();

}  // namespace pleat
