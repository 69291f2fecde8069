// The commands of `pleat`: each adds its options to the command line and gives the function that does the work.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::cli {

inline constexpr int kExitDone = 0;
inline constexpr int kExitFailed = 1;
inline constexpr int kExitWrongInput = 2;
inline constexpr int kExitNotClean = 3;  ///< the result is there, with penetrations or self-intersections

/// A command that was added. `run` returns an exit code or throws pleat::Error.
struct Command {
  CLI::App* app = nullptr;
  std::function<int()> run;
};

std::vector<Command> add_up(CLI::App& root);
std::vector<Command> add_health(CLI::App& root);
std::vector<Command> add_run(CLI::App& root);
std::vector<Command> add_enhance(CLI::App& root);
std::vector<Command> add_dataset(CLI::App& root);
std::vector<Command> add_check(CLI::App& root);
std::vector<Command> add_export(CLI::App& root);
std::vector<Command> add_eval(CLI::App& root);
std::vector<Command> add_bench(CLI::App& root);

/// kExitWrongInput where the user's input is to blame, kExitFailed otherwise.
int exit_code(ErrorCode code);

/// "pleat: message" as one line on stderr.
void print_error(const std::string& message);

/// --tls-ca, --tls-certificate, --tls-key, --tls-server-name, for coordinators on other hosts.
void add_tls_options(CLI::App& app, rpc::TlsOptions& tls);

/// Checks of options, with messages for people: above 0; 0 or above, whole.
CLI::Validator positive_number();
CLI::Validator natural_number();

/// The whole program: parses, runs, turns every exception into one line and an exit code.
int run_program(int argc, const char* const* argv);

}  // namespace pleat::cli
