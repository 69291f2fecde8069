// The viewer as a page of its own: the template with its places filled.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace pleat::presentation {

/// title: plain text. connect: where the page may ask for more, as in `connect-src` of a content security policy. data:
/// script elements, see docs/report.md.
std::string viewer_page(const std::string& title, std::string_view connect, std::string_view data);

/// JSON that can't end the script element it lies in.
std::string script_safe(const nlohmann::json& value);

}  // namespace pleat::presentation
