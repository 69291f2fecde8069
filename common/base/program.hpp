// What the main functions of our programs share: from the command line to an exit code.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>

#include "common/base/exit_codes.hpp"

namespace pleat {

/// "NAME: message" as one line on stderr.
void print_error(const std::string& name, const std::string& message);

/// "; did you mean --frames?" for the first word that the parsed command line did not take, if something like it
/// exists.
std::string suggestion(const CLI::App& root);

/// Parses the command line and runs `body`, which returns an exit code. A wrong command line and every exception become
/// one line on stderr and an exit code, with the likely name for a mistyped command or option; --help and --version
/// end well, and so does --write-manual (manual.hpp). Freed memory is kept for the next allocation. `app` has the
/// program's name.
int run_program(CLI::App& app, int argc, const char* const* argv, const std::function<int()>& body);

/// The deepest subcommand that was reached: "pleat dataset generate".
std::string command_path(const CLI::App& root);

/// Checks of options, with messages for people: above 0; 0 or above, whole.
CLI::Validator positive_number();
CLI::Validator natural_number();

}  // namespace pleat
