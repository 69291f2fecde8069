#include <string>

#include "tests/unit/common/rpc/sample_service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-rpc-sample", [&] {
    pleat::rpc::ServerOptions server;
    pleat::config::Options options("pleat-rpc-sample", "a service for tests", "PLEAT_RPC_SAMPLE_");
    pleat::rpc::add_options(options, server);
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("sample", server.log);
    pleat::telemetry::Metrics metrics("sample");
    pleat::rpc::testing::SampleRefinement service(&metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.Refinement"}}, metrics);
  });
}
