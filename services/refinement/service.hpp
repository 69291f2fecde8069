// pleat.v1.Refinement over Session.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>

#include "common/rpc/drain.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/refinement.grpc.pb.h"
#include "services/refinement/session.hpp"

namespace pleat::refinement {

using ServiceOptions = SessionOptions;

/// Streams are independent of each other; frames of a stream need nothing of earlier ones.
class RefinementService final : public v1::Refinement::Service {
 public:
  RefinementService(const ServiceOptions& options, telemetry::Metrics& metrics)
      : options_(options), metrics_(metrics) {}

  grpc::Status Refine(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) override;

  /// Streams end when what they have read is answered; new ones are refused. A client goes on in another replica.
  void drain() { drain_.begin(); }

 private:
  void count(std::uint64_t index, const RefinementReport& report);

  ServiceOptions options_;
  telemetry::Metrics& metrics_;
  rpc::Drain drain_;
};

}  // namespace pleat::refinement
