// Stands in for a service: serves health under the name that its file name asks for, and nothing else.
// With FAKE_SERVICE_FAILS=NAME the service of that name ends at once with an error line.
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <filesystem>
#include <iterator>
#include <map>

#include "common/base/error.hpp"
#include "common/config/options.hpp"
#include "common/rpc/server.hpp"

int main(int argc, char** argv) {
  const std::string program = std::filesystem::path(argv[0]).filename().string();
  return pleat::rpc::service_main(program, [&] {
    const std::map<std::string, std::string> names = {
        {"pleat-simulation", "pleat.v1.Simulation"},    {"pleat-conversion", "pleat.v1.Conversion"},
        {"pleat-superres", "pleat.v1.SuperResolution"}, {"pleat-fold", "pleat.v1.Fold"},
        {"pleat-refinement", "pleat.v1.Refinement"},    {"pleat-coordinator", "pleat.v1.Coordinator"}};
    const char* fails = std::getenv("FAKE_SERVICE_FAILS");
    if (fails != nullptr && program == std::string("pleat-") + fails)
      pleat::throw_data_loss("bundle.pt: truncated on purpose");
    pleat::rpc::ServerOptions server;
    const char* flags[] = {"simulation", "conversion", "superres", "fold",      "refinement",
                           "data",       "models",     "model",    "give-up-s", "jobs-yield"};
    std::string others[std::size(flags)];
    pleat::config::Options options(program, "A fake.", "FAKE_OPTION_");
    pleat::rpc::add_options(options, server);
    for (std::size_t i = 0; i < std::size(flags); ++i) options.add(flags[i], others[i], "ignored");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging(program, server.log);
    pleat::telemetry::Metrics metrics(program);
    grpc::Service service;
    return pleat::rpc::run_server(server, {{&service, names.at(program)}}, metrics);
  });
}
