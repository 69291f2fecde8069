#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <iostream>
#include <new>

#include "common/base/machine.hpp"
#include "common/base/signals.hpp"
#include "services/cli/command.hpp"

namespace pleat::cli {
namespace {

constexpr const char* kDescription =
    "Pleat turns a cheap coarse cloth simulation into a detailed, collision-free fine mesh, frame by frame.";
constexpr const char* kFooter =
    "Examples:\n"
    "  pleat run deploy/scenes/draping.json --out out/demo\n"
    "  pleat enhance --rest garment.obj --frames 'frames/*.obj' --out out/mine\n"
    "  pleat export out/demo/result.h5 --format pc2\n"
    "\n"
    "Exit codes: 0 done, 1 failed, 2 wrong usage or input.";

/// The deepest subcommand that was reached, for "run with --help".
std::string command_path(const CLI::App& root) {
  std::string path = "pleat";
  const CLI::App* app = &root;
  while (true) {
    const auto subcommands = app->get_subcommands();
    if (subcommands.empty()) return path;
    app = subcommands.front();
    path += " " + app->get_name();
  }
}

}  // namespace

int exit_code(ErrorCode code) {
  switch (code) {
    case ErrorCode::kInvalidArgument:
    case ErrorCode::kNotFound:
    case ErrorCode::kAlreadyExists:
    case ErrorCode::kFailedPrecondition:
    case ErrorCode::kDataLoss:
      return kExitWrongInput;
    default:
      return kExitFailed;
  }
}

void print_error(const std::string& message) {
  std::string line = message;
  std::replace(line.begin(), line.end(), '\n', ' ');
  std::fprintf(stderr, "pleat: %s\n", line.c_str());
}

void add_tls_options(CLI::App& app, rpc::TlsOptions& tls) {
  const auto group = app.add_option_group("TLS", "for a coordinator on another host");
  group->add_option("--tls-ca", tls.ca_file, "certificate authority, PEM file")->envname("PLEAT_TLS_CA");
  group->add_option("--tls-certificate", tls.certificate_file, "this client's certificate, PEM file")
      ->envname("PLEAT_TLS_CERTIFICATE");
  group->add_option("--tls-key", tls.key_file, "its key, PEM file")->envname("PLEAT_TLS_KEY");
  group->add_option("--tls-server-name", tls.server_name, "name in the server's certificate, if it is not the address")
      ->envname("PLEAT_TLS_SERVER_NAME");
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

int run_program(int argc, const char* const* argv) {
  install_signal_handlers();
  CLI::App root(kDescription, "pleat");
  root.set_version_flag("--version", "pleat " + version() + " (" + git_revision() + ")");
  root.require_subcommand(0, 1);
  std::vector<Command> commands;
  for (const auto add : {add_up, add_run, add_enhance, add_check, add_export, add_dataset, add_eval, add_bench, add_health})
    for (Command& command : add(root)) commands.push_back(std::move(command));
  root.footer(kFooter);
  try {
    root.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return root.exit(success);  // --help, --version
  } catch (const CLI::ParseError& error) {
    print_error(std::string(error.what()) + " (see " + command_path(root) + " --help)");
    return kExitWrongInput;
  }
  try {
    for (const Command& command : commands)
      if (command.app->parsed()) return command.run();
    print_error(command_path(root) + ": no command given (see " + command_path(root) + " --help)");
    return kExitWrongInput;
  } catch (const Error& error) {
    print_error(error.what());
    return exit_code(error.code());
  } catch (const std::bad_alloc&) {
    print_error("out of memory");
  } catch (const std::exception& error) {
    print_error(error.what());
  }
  return kExitFailed;
}

}  // namespace pleat::cli
