// pleat.v1.Fold over Session.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>

#include "common/rpc/drain.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/fold.grpc.pb.h"
#include "services/fold/session.hpp"

namespace pleat::fold {

using ServiceOptions = SessionOptions;

/// Streams are independent of each other; the frames of a stream are made one after the other.
class FoldService final : public v1::Fold::Service {
 public:
  FoldService(const ServiceOptions& options, telemetry::Metrics& metrics) : options_(options), metrics_(metrics) {}

  grpc::Status Fold(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::FoldResponse, v1::FoldRequest>* stream) override;

  /// Streams end when what they have read is answered; new ones are refused. A client goes on in another replica.
  void drain() { drain_.begin(); }

 private:
  void count(std::uint64_t index, const FoldReport& report);

  ServiceOptions options_;
  telemetry::Metrics& metrics_;
  rpc::Drain drain_;
};

}  // namespace pleat::fold
