// pleat.v1.Conversion over ImageMap.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>

#include "common/telemetry/metrics.hpp"
#include "pleat/v1/conversion.grpc.pb.h"

namespace pleat::conversion {

struct ServiceOptions {
  std::int64_t max_vertices = 1'000'000;  ///< of the fine mesh of a session
  std::int64_t max_texels = 4'000'000;    ///< of the fine image of a session
};

/// Streams are independent of each other; frames of a stream need nothing of earlier ones.
class ConversionService final : public v1::Conversion::Service {
 public:
  ConversionService(const ServiceOptions& options, telemetry::Metrics& metrics)
      : options_(options), metrics_(metrics) {}

  grpc::Status ToImage(grpc::ServerContext* context,
                       grpc::ServerReaderWriter<v1::ToImageResponse, v1::ToImageRequest>* stream) override;
  grpc::Status ToMesh(grpc::ServerContext* context,
                      grpc::ServerReaderWriter<v1::ToMeshResponse, v1::ToMeshRequest>* stream) override;

 private:
  ServiceOptions options_;
  telemetry::Metrics& metrics_;
};

}  // namespace pleat::conversion
