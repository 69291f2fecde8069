// pleat.v1.Refinement over Refiner.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>

#include "common/telemetry/metrics.hpp"
#include "pleat/v1/refinement.grpc.pb.h"

namespace pleat::refinement {

struct ServiceOptions {
  std::int64_t max_vertices = 1'000'000;  ///< of the fine mesh of a session
  int bisections = 5;                     ///< weights of impact zones are found to 2^-bisections
  int threads = 0;                        ///< of a session; 0: as many as there are processors
};

/// Streams are independent of each other; frames of a stream need nothing of earlier ones.
class RefinementService final : public v1::Refinement::Service {
 public:
  RefinementService(const ServiceOptions& options, telemetry::Metrics& metrics)
      : options_(options), metrics_(metrics) {}

  grpc::Status Refine(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) override;

 private:
  ServiceOptions options_;
  telemetry::Metrics& metrics_;
};

}  // namespace pleat::refinement
