#include "common/base/json.hpp"

#include "common/base/error.hpp"

namespace pleat {

nlohmann::json parse_json(std::string_view text, const std::string& name) {
  try {
    return nlohmann::json::parse(text, nullptr, true, true);
  } catch (const nlohmann::json::exception& error) {
    const std::string what = error.what();
    const auto line = what.find("line ");
    // "[json.exception.parse_error.101] parse error at line 1, column 2: ..."
    const auto bracket = what.find("] ");
    const auto begin = line != std::string::npos ? line : bracket == std::string::npos ? 0 : bracket + 2;
    throw_invalid_argument(name + ": not JSON: " + what.substr(begin));
  }
}

std::string plain_json(const std::string& text, const std::string& name) {
  const nlohmann::json document = parse_json(text, name);
  return nlohmann::json::accept(text) ? text : document.dump();
}

}  // namespace pleat
