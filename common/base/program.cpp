#include "common/base/program.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <new>

namespace pleat {

void print_error(const std::string& name, const std::string& message) {
  std::string line = message;
  std::replace(line.begin(), line.end(), '\n', ' ');
  std::fprintf(stderr, "%s: %s\n", name.c_str(), line.c_str());
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
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);  // --help, --version
  } catch (const CLI::ParseError& error) {
    print_error(name, std::string(error.what()) + " (see " + command_path(app) + " --help)");
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
