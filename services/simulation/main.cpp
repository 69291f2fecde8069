// The simulation service.
#include "common/base/runtime_folder.hpp"
#include "common/rpc/server.hpp"
#include "services/simulation/service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-simulation", [&] {
    pleat::rpc::ServerOptions server;
    server.listen = pleat::default_address("simulation");
    pleat::simulation::ServiceOptions simulation;
    pleat::config::Options options("pleat-simulation", "Cloth physics: coarse frames, and fine frames that track them.",
                                   "PLEAT_SIMULATION_");
    pleat::rpc::add_options(options, server);
    options.add("threads", simulation.threads, "threads of a session; 0: the processors this process may use");
    options.add("max-vertices", simulation.max_vertices, "largest mesh of a session");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("simulation", server.log);
    pleat::telemetry::Metrics metrics("simulation");
    pleat::simulation::SimulationService service(simulation, metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.Simulation", [&] { service.drain(); }}}, metrics);
  });
}
