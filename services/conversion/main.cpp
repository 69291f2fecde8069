// The conversion service.
#include "common/base/runtime_folder.hpp"
#include "common/rpc/server.hpp"
#include "services/conversion/service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-conversion", [&] {
    pleat::rpc::ServerOptions server;
    server.listen = pleat::default_address("conversion");
    pleat::conversion::ServiceOptions conversion;
    pleat::config::Options options("pleat-conversion", "Coarse meshes to geometry images, fine images to meshes.",
                                   "PLEAT_CONVERSION_");
    pleat::rpc::add_options(options, server);
    options.add("max-vertices", conversion.limits.max_vertices, "largest fine mesh of a session")
        .add("max-texels", conversion.limits.max_texels, "largest fine image of a session")
        .add("cached-maps", conversion.cached_maps, "fine vertices and texels of maps kept for sessions to come");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("conversion", server.log);
    pleat::telemetry::Metrics metrics("conversion");
    pleat::conversion::ConversionService service(conversion, metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.Conversion", [&] { service.drain(); }}}, metrics);
  });
}
