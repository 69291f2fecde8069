// The fold service.
#include "common/base/runtime_folder.hpp"
#include "common/rpc/server.hpp"
#include "services/fold/service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-fold", [&] {
    pleat::rpc::ServerOptions server;
    server.listen = pleat::default_address("fold");
    pleat::fold::ServiceOptions fold;
    pleat::config::Options options("pleat-fold", "Makes fine frames by physics, held to the coarse cloth.",
                                   "PLEAT_FOLD_");
    pleat::rpc::add_options(options, server);
    options.add("max-vertices", fold.max_vertices, "largest fine mesh of a session");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("fold", server.log);
    pleat::telemetry::Metrics metrics("fold");
    pleat::fold::FoldService service(fold, metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.Fold", [&] { service.drain(); }}}, metrics);
  });
}
