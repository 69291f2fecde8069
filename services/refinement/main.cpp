// The refinement service.
#include "common/base/runtime_folder.hpp"
#include "common/rpc/server.hpp"
#include "services/refinement/service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-refinement", [&] {
    pleat::rpc::ServerOptions server;
    server.listen = pleat::default_address("refinement");
    pleat::refinement::ServiceOptions refinement;
    pleat::config::Options options("pleat-refinement", "Makes fine frames free of penetrations and self-intersections.",
                                   "PLEAT_REFINEMENT_");
    pleat::rpc::add_options(options, server);
    options.add("max-vertices", refinement.max_vertices, "largest fine mesh of a session")
        .add("bisections", refinement.bisections, "weights of impact zones are found to 2^-bisections")
        .add("threads", refinement.threads, "threads of a session (0: as many as there are processors)");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("refinement", server.log);
    pleat::telemetry::Metrics metrics("refinement");
    pleat::refinement::RefinementService service(refinement, metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.Refinement", [&] { service.drain(); }}}, metrics);
  });
}
