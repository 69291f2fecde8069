// `pleat up`: all services on this host. `pleat health`: one service, for container health checks.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <optional>
#include <thread>

#include "common/base/signals.hpp"
#include "services/cli/command.hpp"
#include "services/cli/launcher/launcher.hpp"
#include "services/presentation/live/live_page.hpp"

namespace pleat::cli {
namespace {

struct UpOptions {
  std::string listen, models, metrics_listen, data, token_file, page, page_token_file;
  double answer_timeout_s = 20;
};

int up(const UpOptions& options) {
  if (!options.listen.empty() && !rpc::is_local_address(options.listen))
    throw_invalid_argument("--listen " + options.listen +
                           ": not a local address; beyond this host run pleat-coordinator itself, with --tls-*");
  if (!options.page.empty()) presentation::check_listen(options.page);
  LauncherOptions launch;
  launch.models = options.models;
  launch.data = options.data.empty() ? state_folder("services") : std::filesystem::path(options.data);
  launch.logs = launch.data / "logs";
  launch.listen = options.listen;
  launch.metrics_listen = options.metrics_listen;
  launch.token_file = options.token_file;
  launch.shared = true;
  launch.patience = std::chrono::milliseconds(std::lround(options.answer_timeout_s * 1000));
  Launcher launcher(launch);
  for (const Launcher::Service& service : launcher.services())
    std::printf("%-12s %s\n", service.name.c_str(), service.address.c_str());
  std::optional<presentation::LivePage> page;
  if (!options.page.empty()) {
    rpc::TlsOptions identity;
    identity.token_file = options.page_token_file;
    page.emplace(presentation::LivePageOptions{options.page, launcher.coordinator(), identity});
    std::printf("%-12s %s\n", "page", page->address().c_str());
  }
  std::printf("ready %s\n", launcher.coordinator().c_str());
  std::fflush(stdout);
  while (!interrupted()) {
    for (const std::string& line : launcher.supervise()) {
      std::fprintf(stderr, "%s\n", line.c_str());
      if (page) page->note(line);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  page.reset();
  launcher.stop();
  return kExitDone;
}

}  // namespace

std::vector<Command> add_up(CLI::App& root) {
  CLI::App* app = root.add_subcommand("up", "start all services on this host, until Ctrl-C");
  const auto options = std::make_shared<UpOptions>();
  app->add_option(
      "--listen", options->listen,
      "address of the coordinator: unix:PATH or 127.0.0.1:PORT, port 0 for any (default: a private socket)");
  app->add_option("--models", options->models, "folder of the model bundles (default: deploy/models)");
  app->add_option("--data", options->data,
                  "folder for jobs and logs (default: out/services in a build, else $XDG_STATE_HOME/pleat/services)");
  app->add_option("--answer-timeout-s", options->answer_timeout_s,
                  "a service that does not answer health checks this long is replaced")
      ->capture_default_str()
      ->check(positive_number());
  app->add_option("--metrics-listen", options->metrics_listen, "Prometheus endpoint of the coordinator, HOST:PORT");
  app->add_option("--token-file", options->token_file,
                  "file of NAME ROLE TOKEN, mode 0600: who may call; for --listen with a port, which all users of this "
                  "host reach");
  app->add_option("--page", options->page,
                  "live page of the jobs and sessions, for a browser on this host, 127.0.0.1:PORT; its address, which "
                  "is printed, has a token");
  app->add_option("--page-token-file", options->page_token_file,
                  "with --token-file: file with the token that the page reads jobs by, best of a watcher");
  return {{app, [options] { return up(*options); }}};
}

std::vector<Command> add_health(CLI::App& root) {
  struct HealthOptions {
    std::string address, service;
    double timeout_s = 2;
    rpc::TlsOptions tls;
  };
  CLI::App* app = root.add_subcommand("health", "ask a service whether it serves; exit code 0 if so");
  const auto options = std::make_shared<HealthOptions>();
  app->add_option("address", options->address, "unix:PATH, HOST:PORT or dns:///NAME:PORT")->required();
  app->add_option("service", options->service, "full name, for example pleat.v1.Coordinator")->required();
  app->add_option("--timeout", options->timeout_s, "seconds")->capture_default_str()->check(positive_number());
  add_tls_options(*app, options->tls);
  return {{app, [options] {
             const auto timeout = std::chrono::milliseconds(static_cast<long>(options->timeout_s * 1000));
             const auto channel = rpc::create_channel(options->address, options->tls);
             rpc::wait_healthy(channel, options->service, options->address, timeout);
             std::printf("%s at %s serves\n", options->service.c_str(), options->address.c_str());
             return kExitDone;
           }}};
}

}  // namespace pleat::cli
