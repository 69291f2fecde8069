#include "services/presentation/report/viewer_page.hpp"

#include "common/base/error.hpp"
#include "common/base/html.hpp"
#include "services/presentation/report/viewer_template.hpp"

namespace pleat::presentation {
namespace {

std::string replace_once(std::string_view text, std::string_view marker, std::string_view value) {
  const std::size_t place = text.find(marker);
  if (place == std::string_view::npos) throw_internal("the viewer has no marker " + std::string(marker));
  std::string out;
  out.reserve(text.size() + value.size());
  out += text.substr(0, place);
  out += value;
  out += text.substr(place + marker.size());
  return out;
}

}  // namespace

std::string viewer_page(const std::string& title, std::string_view connect, std::string_view data) {
  // The data last: what they hold is not to be taken for a marker.
  const std::string titled = replace_once(viewer_template(), "PLEAT_TITLE", escape_html(title));
  return replace_once(replace_once(titled, "PLEAT_CONNECT", connect), "<!-- PLEAT_DATA -->", data);
}

std::string script_safe(const nlohmann::json& value) {
  std::string out;
  for (const char c : value.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace)) {
    if (c == '<') {
      out += "\\u003c";
    } else {
      out += c;
    }
  }
  return out;
}

}  // namespace pleat::presentation
