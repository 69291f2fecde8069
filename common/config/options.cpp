#include "common/config/options.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/manual.hpp"
#include "common/base/program.hpp"
#include "common/base/version.hpp"

namespace pleat::config {
namespace {

std::string with(std::string text, char from, char to) {
  std::replace(text.begin(), text.end(), from, to);
  return text;
}

std::string environment_name(const std::string& prefix, std::string name) {
  name = with(std::move(name), '-', '_');
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
  return prefix + name;
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  while (begin <= text.size()) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    if (end > begin) parts.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return parts;
}

const std::string& single(const std::string& name, const std::vector<std::string>& texts) {
  if (texts.size() != 1) throw_invalid_argument("option " + name + " takes one value");
  return texts.front();
}

}  // namespace

Options::Options(std::string program, std::string description, std::string environment_prefix)
    : program_(std::move(program)), description_(std::move(description)), prefix_(std::move(environment_prefix)) {}

bool Options::parse(int argc, const char* const* argv) {
  CLI::App app(description_, program_);
  app.set_version_flag("--version", program_ + " " + version(), "print the version");
  std::string config_file;
  app.add_option("--config", config_file, "JSON file with options; keys as the flags, with _ for -");
  std::vector<std::vector<std::string>> from_flags(entries_.size());
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    const Entry& entry = entries_[i];
    const std::string help =
        entry.help + " [" + entry.get() + "]; environment: " + environment_name(prefix_, entry.name);
    if (entry.kind == Kind::kBool) {
      // --name, --name=false and --no-name
      app.add_flag("--" + entry.name + ",!--no-" + entry.name, from_flags[i], help);
    } else {
      CLI::Option* option = app.add_option("--" + entry.name, from_flags[i], help);
      if (entry.kind == Kind::kList) {
        option->expected(1)->take_all();
      } else {
        option->expected(1);
      }
    }
  }
  if (const auto folder = manual_folder(argc, argv); !folder.empty()) {
    write_manual(app, version(), folder);
    return false;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    std::cout << help();
    return false;
  } catch (const CLI::CallForVersion& call) {
    std::cout << call.what() << "\n";
    return false;
  } catch (const CLI::ParseError& error) {
    throw_invalid_argument(error.what() + suggestion(app));
  }

  if (const char* variable = std::getenv((prefix_ + "CONFIG").c_str()); config_file.empty() && variable != nullptr) {
    config_file = variable;
  }
  nlohmann::json file = nlohmann::json::object();
  if (!config_file.empty()) {
    std::ifstream stream(config_file);
    if (!stream) throw_not_found(config_file + ": can't be read");
    file = nlohmann::json::parse(stream, nullptr, false, true);
    if (!file.is_object()) throw_invalid_argument(config_file + ": not a JSON object");
  }
  std::vector<std::string> variables, keys;
  for (const Entry& entry : entries_) {
    variables.push_back(environment_name(prefix_, entry.name));
    keys.push_back(with(entry.name, '-', '_'));
  }
  for (const auto& item : file.items()) {
    if (std::find(keys.begin(), keys.end(), item.key()) == keys.end()) {
      throw_invalid_argument(config_file + ": unknown key \"" + item.key() + "\"");
    }
  }
  for (char** variable = environ; *variable != nullptr; ++variable) {
    const std::string text = *variable;
    const std::string name = text.substr(0, text.find('='));
    if (name.rfind(prefix_, 0) == 0 && name != prefix_ + "CONFIG" &&
        std::find(variables.begin(), variables.end(), name) == variables.end()) {
      throw_invalid_argument("unknown environment variable " + name);
    }
  }

  const auto text_of = [](const nlohmann::json& value) {
    return value.is_string() ? value.get<std::string>() : value.dump();
  };
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    const Entry& entry = entries_[i];
    std::string source;
    std::vector<std::string> texts;
    if (!from_flags[i].empty()) {
      source = "--" + entry.name;
      texts = from_flags[i];
    } else if (const char* variable = std::getenv(variables[i].c_str()); variable != nullptr) {
      source = variables[i];
      texts = entry.kind == Kind::kList ? split(variable) : std::vector<std::string>{variable};
    } else if (file.contains(keys[i])) {
      source = config_file + ": " + keys[i];
      const nlohmann::json& value = file[keys[i]];
      if (value.is_array() != (entry.kind == Kind::kList) || value.is_object() || value.is_null()) {
        throw_invalid_argument(source + ": a value of another kind is needed");
      }
      if (value.is_array()) {
        for (const auto& part : value) texts.push_back(text_of(part));
      } else {
        texts.push_back(text_of(value));
      }
    } else {
      continue;
    }
    try {
      entry.set(texts);
    } catch (const Error& error) {
      throw_invalid_argument(source + ": " + error.what());
    }
  }
  return true;
}

std::string Options::effective() const {
  std::string text = "{";
  for (const Entry& entry : entries_) {
    if (text.size() > 1) text += ", ";
    text += "\"" + with(entry.name, '-', '_') + "\": " + entry.get();
  }
  return text + "}";
}

std::string Options::help() const {
  std::string text =
      program_ + ": " + description_ + "\n\nOptions (flag, or environment variable, or key in --config FILE):\n";
  std::size_t width = 0;
  for (const Entry& entry : entries_) width = std::max(width, entry.name.size());
  for (const Entry& entry : entries_) {
    text += "  --" + entry.name + std::string(width - entry.name.size() + 2, ' ') + entry.help + " [" + entry.get() +
            "]  " + environment_name(prefix_, entry.name) + "\n";
  }
  return text;
}

void Options::assign(const std::string& name, const std::vector<std::string>& texts, bool& value) {
  const std::string& text = single(name, texts);
  if (text == "true" || text == "1" || text == "yes" || text == "on") {
    value = true;
  } else if (text == "false" || text == "0" || text == "no" || text == "off") {
    value = false;
  } else {
    throw_invalid_argument("'" + text + "' is neither true nor false");
  }
}

void Options::assign(const std::string& name, const std::vector<std::string>& texts, std::string& value) {
  value = single(name, texts);
}

void Options::assign(const std::string& /*name*/, const std::vector<std::string>& texts,
                     std::vector<std::string>& value) {
  value = texts;
}

long long Options::to_integer(const std::string& name, const std::vector<std::string>& texts, long long minimum,
                              unsigned long long maximum) {
  const std::string& text = single(name, texts);
  long long value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    throw_invalid_argument("'" + text + "' is not a whole number");
  }
  if (value < minimum || (value > 0 && static_cast<unsigned long long>(value) > maximum)) {
    throw_invalid_argument("'" + text + "' is out of range");
  }
  return value;
}

double Options::to_number(const std::string& name, const std::vector<std::string>& texts) {
  const std::string& text = single(name, texts);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    throw_invalid_argument("'" + text + "' is not a number");
  }
  return value;
}

std::string Options::describe(bool value) { return value ? "true" : "false"; }
std::string Options::describe(double value) { return nlohmann::json(value).dump(); }
std::string Options::describe(const std::string& value) {
  return nlohmann::json(value).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}
std::string Options::describe(const std::vector<std::string>& value) {
  return nlohmann::json(value).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace pleat::config
