// pleat.v1.Conversion over Session.
#pragma once

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <cstdint>
#include <memory>

#include "common/rpc/drain.hpp"
#include "common/telemetry/metrics.hpp"
#include "pleat/v1/conversion.grpc.pb.h"
#include "services/conversion/session.hpp"

namespace pleat::conversion {

struct ServiceOptions {
  SessionLimits limits;
  /// Fine vertices and texels of the maps kept for sessions to come, in all: about 100 bytes each.
  std::int64_t cached_maps = 4'000'000;
};

/// Streams are independent of each other; frames of a stream need nothing of earlier ones.
class ConversionService final : public v1::Conversion::Service {
 public:
  ConversionService(const ServiceOptions& options, telemetry::Metrics& metrics)
      : options_(options),
        metrics_(metrics),
        maps_(static_cast<std::size_t>(std::max<std::int64_t>(options.cached_maps, 0))) {}

  grpc::Status Describe(grpc::ServerContext* context, const v1::ConversionSetup* setup,
                        v1::ConversionOpened* opened) override;
  grpc::Status ToImage(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::ToImageResponse, v1::ToImageRequest>* stream) override;
  grpc::Status ToMesh(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::ToMeshResponse, v1::ToMeshRequest>* stream) override;

  /// Streams end when what they have read is answered; new ones are refused. A client goes on in another replica.
  void drain() { drain_.begin(); }

 private:
  std::shared_ptr<Session> open(const v1::ConversionSetup& setup, bool with_fine, v1::Tensor::DType dtype,
                                v1::ConversionOpened* opened);

  ServiceOptions options_;
  telemetry::Metrics& metrics_;
  rpc::Drain drain_;
  RepresentationCache maps_;
};

}  // namespace pleat::conversion
