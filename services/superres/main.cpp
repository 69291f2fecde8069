// The super-resolution service.
#include "common/base/runtime_folder.hpp"
#include "common/rpc/server.hpp"
#include "services/superres/service.hpp"

int main(int argc, char** argv) {
  return pleat::rpc::service_main("pleat-superres", [&] {
    pleat::rpc::ServerOptions server;
    server.listen = pleat::default_address("superres");
    pleat::superres::ServiceOptions superres;
    pleat::config::Options options("pleat-superres", "Fine geometry images from coarse ones, by a trained network.",
                                   "PLEAT_SUPERRES_");
    pleat::rpc::add_options(options, server);
    options.add("models", superres.models, "folder of the model bundles")
        .add("model", superres.model, "default bundle, loaded before the service is healthy; '' for none")
        .add("precision", superres.precision, "auto, float32 or bfloat16")
        .add("threads", superres.threads, "threads of one inference; 0: the processors this process may use")
        .add("batch", superres.largest_batch, "frames of several sessions in one inference at most")
        .add("batch-latency-ms", superres.batch_latency_ms, "how long a frame waits for those of other sessions")
        .add("loaded-models", superres.loaded_models, "bundles in memory at most")
        .add("cuda", superres.cuda, "use a CUDA device where there is one");
    if (!options.parse(argc, argv)) return 0;
    pleat::telemetry::set_up_logging("superres", server.log);
    pleat::telemetry::Metrics metrics("superres");
    pleat::superres::SuperResolutionService service(superres, metrics);
    return pleat::rpc::run_server(server, {{&service, "pleat.v1.SuperResolution", [&] { service.drain(); }}}, metrics);
  });
}
