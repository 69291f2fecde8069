#include <algorithm>

#include "common/base/machine.hpp"
#include "common/base/manual.hpp"
#include "common/base/signals.hpp"
#include "common/base/terminal.hpp"
#include "common/frame/detail.hpp"
#include "services/cli/command.hpp"

namespace pleat::cli {
namespace {

constexpr const char* kDescription =
    "Pleat turns a cheap coarse cloth simulation into a detailed, collision-free fine mesh, frame by frame.";
constexpr const char* kFooter =
    "Examples:\n"
    "  pleat run draping --out out/demo\n"
    "  pleat enhance frames/*.obj --rest garment.obj --out out/mine\n"
    "  pleat export out/demo/result.h5 --format pc2\n"
    "\n"
    "`pleat help COMMAND` lists a command's options.\n"
    "Exit codes: 0 done, 1 failed, 2 wrong usage or input, 3 done, but not free of intersections,\n"
    "75 not done yet: run it again.";

/// `pleat help dataset generate` is `pleat dataset generate --help`; an unknown command stays alone, to be refused.
std::vector<const char*> with_help(const CLI::App& root, int argc, const char* const* argv) {
  std::vector<const char*> words(argv, argv + argc);
  if (words.size() < 2 || std::string_view(words[1]) != "help") return words;
  std::vector<const char*> asked{words[0]};
  std::vector<const CLI::App*> commands = visible_commands(root);
  for (std::size_t i = 2; i < words.size() && !commands.empty(); ++i) {
    asked.push_back(words[i]);
    const auto found = std::find_if(commands.begin(), commands.end(),
                                    [&](const CLI::App* command) { return command->get_name() == words[i]; });
    if (found == commands.end()) return asked;
    commands = visible_commands(**found);
  }
  asked.push_back("--help");
  return asked;
}

void add_verbosity(CLI::App& app, bool& quiet, bool& verbose) {
  const auto option = app.add_flag("-q,--quiet", quiet, "no progress and no notes: errors and warnings alone");
  app.add_flag("-v,--verbose", verbose, "also what is done on the way, on stderr")->excludes(option);
}

}  // namespace

void add_tls_options(CLI::App& app, rpc::TlsOptions& tls) {
  const auto group = app.add_option_group("Identity", "for a coordinator on another host, or one that wants a token");
  group->add_option("--tls-ca", tls.ca_file, "certificate authority, PEM file")->envname("PLEAT_TLS_CA");
  group->add_option("--tls-certificate", tls.certificate_file, "this client's certificate, PEM file")
      ->envname("PLEAT_TLS_CERTIFICATE");
  group->add_option("--tls-key", tls.key_file, "its key, PEM file")->envname("PLEAT_TLS_KEY");
  group->add_option("--tls-server-name", tls.server_name, "name in the server's certificate, if it is not the address")
      ->envname("PLEAT_TLS_SERVER_NAME");
  group->add_option("--token-file", tls.token_file, "file with this client's token, where the coordinator wants one")
      ->envname("PLEAT_TOKEN_FILE");
}

void add_json_option(CLI::App& app, bool& json, const std::string& what) { app.add_flag("--json", json, what); }

void add_detail_option(CLI::App& app, std::string& detail) {
  app.add_option(
         "--detail", detail,
         "what makes the wrinkles: a network, the fold step (no bundle), both, or none: smooth upsampling alone "
         "(default: network with --model, else fold)")
      ->check(CLI::IsMember({"network", "fold", "both", "none"}));
}

int run_pleat(int argc, const char* const* argv) {
  install_signal_handlers();
  CLI::App root(kDescription, "pleat");
  root.set_version_flag("--version", "pleat " + version() + " (" + git_revision() + ")", "print the version");
  root.require_subcommand(0, 1);
  std::vector<Command> commands;
  for (const auto add : {add_up, add_run, add_simulate, add_enhance, add_check, add_export, add_body, add_dress,
                         add_dataset, add_learn, add_eval, add_bench, add_bridge, add_jobs, add_top, add_health})
    for (Command& command : add(root)) commands.push_back(std::move(command));
  root.footer(kFooter);
  bool quiet = false, verbose = false;
  add_verbosity(root, quiet, verbose);
  for (const Command& command : commands) add_verbosity(*command.app, quiet, verbose);
  const std::vector<const char*> words = with_help(root, argc, argv);
  return run_program(root, static_cast<int>(words.size()), words.data(), [&] {
    if (quiet || verbose) set_verbosity(quiet ? Verbosity::kQuiet : Verbosity::kVerbose);
    for (const Command& command : commands)
      if (command.app->parsed()) return command.run();
    print_error("pleat", command_path(root) + ": no command given (see " + command_path(root) + " --help)");
    return kExitWrongInput;
  });
}

}  // namespace pleat::cli
