// The gRPC face of the simulation.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>

#include "common/base/limits.hpp"
#include "common/rpc/drain.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/simulation.grpc.pb.h"

namespace pleat::simulation {

struct ServiceOptions {
  int threads = 0;                                      ///< per session; 0: the processors this process may use
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the finest mesh of a session
};

/// One simulation per stream. Sessions are independent of each other.
class SimulationService final : public v1::Simulation::Service {
 public:
  SimulationService(const ServiceOptions& options, telemetry::Metrics& metrics)
      : options_(options), metrics_(metrics) {}

  grpc::Status Simulate(grpc::ServerContext* context,
                        grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>* stream) override;

  /// Ends the sessions after their current frame with UNAVAILABLE, and refuses new ones: a client resumes elsewhere
  /// from its check-point.
  void drain() { drain_.begin(); }

 private:
  ServiceOptions options_;
  telemetry::Metrics& metrics_;
  rpc::Drain drain_;
};

}  // namespace pleat::simulation
