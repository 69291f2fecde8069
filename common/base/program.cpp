#include "common/base/program.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <new>
#include <vector>

#include "common/base/bounded_text.hpp"
#include "common/base/freed_memory.hpp"
#include "common/base/manual.hpp"
#include "common/base/terminal.hpp"
#include "common/base/version.hpp"

namespace pleat {
namespace {

/// Levenshtein's, with a swap of neighbours as one change.
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i) d[i][0] = i;
  for (std::size_t j = 0; j <= b.size(); ++j) d[0][j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    for (std::size_t j = 1; j <= b.size(); ++j) {
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  }
  return d[a.size()][b.size()];
}

}  // namespace

std::string suggestion(const CLI::App& root) {
  const CLI::App* app = &root;
  while (!app->get_subcommands().empty()) app = app->get_subcommands().front();
  std::vector<std::string> names;
  for (const CLI::App* command : visible_commands(*app)) names.push_back(command->get_name());
  for (const CLI::Option* option : visible_options(*app)) {
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  }
  for (std::string word : root.remaining(true)) {
    word = word.substr(0, word.find('='));
    if (word.size() > 40) continue;
    std::size_t least = std::max<std::size_t>(1, word.size() / 3) + 1;
    std::string nearest;
    for (const std::string& name : names) {
      const std::size_t distance = edit_distance(word, name);
      if (!name.empty() && distance < least) {
        least = distance;
        nearest = name;
      }
    }
    if (!nearest.empty()) return "; did you mean " + nearest + "?";
  }
  return "";
}

void print_error(const std::string& name, const std::string& message) {
  std::string line = bounded_text(message);
  std::replace(line.begin(), line.end(), '\n', ' ');
  std::fprintf(stderr, "%s %s\n", colored(name + ":", Color::kRed).c_str(), line.c_str());
}

std::string command_path(const CLI::App& root) {
  std::string path = root.get_name();
  const CLI::App* app = &root;
  while (true) {
    const auto subcommands = app->get_subcommands();
    if (subcommands.empty()) return path;
    app = subcommands.front();
    path += " " + app->get_name();
  }
}

int run_program(CLI::App& app, int argc, const char* const* argv, const std::function<int()>& body) {
  const std::string name = app.get_name();
  keep_freed_memory();
  if (app.get_version_ptr() == nullptr) app.set_version_flag("--version", name + " " + version(), "print the version");
  try {
    if (const auto folder = manual_folder(argc, argv); !folder.empty()) {
      write_manual(app, version(), folder);
      return kExitDone;
    }
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);  // --help, --version
  } catch (const Error& error) {
    print_error(name, error.what());
    return exit_code(error.code());
  } catch (const CLI::ParseError& error) {
    print_error(name, std::string(error.what()) + suggestion(app) + " (see " + command_path(app) + " --help)");
    return kExitWrongInput;
  }
  try {
    return body();
  } catch (const Error& error) {
    print_error(name, error.what());
    return exit_code(error.code());
  } catch (const std::bad_alloc&) {
    print_error(name, "out of memory");
  } catch (const std::exception& error) {
    print_error(name, error.what());
  }
  return kExitFailed;
}

CLI::Validator positive_number() {
  return CLI::Validator(
      [](std::string& text) -> std::string {
        double value = 0;
        if (CLI::detail::lexical_cast(text, value) && value > 0 && std::isfinite(value)) return {};
        return "'" + text + "' is not a number above 0";
      },
      "> 0");
}

CLI::Validator natural_number() {
  return CLI::Validator(
      [](std::string& text) -> std::string {
        if (!text.empty() && text.size() < 19 && text.find_first_not_of("0123456789") == std::string::npos) return {};
        return "'" + text + "' is not a whole number";
      },
      ">= 0");
}

}  // namespace pleat
