// pleat-coordinator: sequences the stages per frame; jobs that end in a result file, and live sessions.
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include "common/base/runtime_folder.hpp"
#include "common/config/options.hpp"
#include "common/rpc/server.hpp"
#include "services/coordinator/service.hpp"

namespace {

int run(int argc, char** argv) {
  pleat::rpc::ServerOptions server;
  server.listen = pleat::default_address("coordinator");
  pleat::coordinator::CoordinatorOptions coordinator;

  pleat::config::Options options("pleat-coordinator", "Sequences the stages per frame: jobs and live sessions.",
                                 "PLEAT_COORDINATOR_");
  pleat::rpc::add_options(options, server);
  pleat::coordinator::add_options(options, coordinator);
  if (!options.parse(argc, argv)) return 0;
  coordinator.live.max_vertices = coordinator.jobs.max_vertices;
  umask(0077);  // whose jobs they are is nobody else's business on this host either
  pleat::telemetry::set_up_logging("coordinator", server.log);
  spdlog::info("options: {}", options.effective());

  pleat::telemetry::Metrics metrics("coordinator");
  pleat::coordinator::CoordinatorService service(coordinator, &metrics);
  return pleat::rpc::run_server(
      server, {{&service, "pleat.v1.Coordinator", [&] { service.drain(); }, [&] { return service.has_room(); }}},
      metrics);
}

}  // namespace

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-coordinator", [&] { return run(argc, argv); });
}
