// JSON that people write: comments are allowed, faults have a place.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace pleat {

/// The document; `//` and `/* */` comments are skipped, as ARCSim's reader does. Throws kInvalidArgument: "NAME: not
/// JSON: line 3, column 5: ...".
nlohmann::json parse_json(std::string_view text, const std::string& name);

/// The same document without comments: `text` itself if it has none.
std::string plain_json(const std::string& text, const std::string& name);

}  // namespace pleat
