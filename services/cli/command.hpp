// The commands of `pleat`: each adds its options to the command line and gives the function that does the work.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>
#include <vector>

#include "common/base/program.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::cli {

/// A command that was added. `run` returns an exit code or throws pleat::Error.
struct Command {
  CLI::App* app = nullptr;
  std::function<int()> run;
};

std::vector<Command> add_up(CLI::App& root);
std::vector<Command> add_health(CLI::App& root);
std::vector<Command> add_run(CLI::App& root);
std::vector<Command> add_simulate(CLI::App& root);
std::vector<Command> add_enhance(CLI::App& root);
std::vector<Command> add_dataset(CLI::App& root);
std::vector<Command> add_bridge(CLI::App& root);
std::vector<Command> add_check(CLI::App& root);
std::vector<Command> add_export(CLI::App& root);
std::vector<Command> add_body(CLI::App& root);
std::vector<Command> add_dress(CLI::App& root);
std::vector<Command> add_eval(CLI::App& root);
std::vector<Command> add_learn(CLI::App& root);
std::vector<Command> add_bench(CLI::App& root);
std::vector<Command> add_jobs(CLI::App& root);
std::vector<Command> add_top(CLI::App& root);

/// --tls-ca, --tls-certificate, --tls-key, --tls-server-name, --token-file: who we are to a coordinator.
void add_tls_options(CLI::App& app, rpc::TlsOptions& tls);

/// --json; `what`: the form of what is printed.
void add_json_option(CLI::App& app, bool& json, const std::string& what);

/// --detail network|fold|both|none; empty: what the coordinator takes where nobody says it.
void add_detail_option(CLI::App& app, std::string& detail);

/// The whole program: parses, runs, turns every exception into one line and an exit code.
int run_pleat(int argc, const char* const* argv);

}  // namespace pleat::cli
