#include "services/conversion/service.hpp"

#include "common/rpc/stream.hpp"

namespace pleat::conversion {

std::shared_ptr<Session> ConversionService::open(const v1::ConversionSetup& setup, bool with_fine,
                                                 v1::Tensor::DType dtype, v1::ConversionOpened* opened) {
  auto session = std::make_shared<Session>(setup, options_.limits, maps_, dtype);
  if (session->was_cached()) metrics_.count("cached_maps");
  session->describe(with_fine, opened);
  return session;
}

grpc::Status ConversionService::Describe(grpc::ServerContext* context, const v1::ConversionSetup* setup,
                                         v1::ConversionOpened* opened) {
  return rpc::guard([&] {
    const telemetry::TraceScope trace(rpc::trace_of(*context));
    open(*setup, true, v1::Tensor::DTYPE_FLOAT32, opened);
  });
}

grpc::Status ConversionService::ToImage(grpc::ServerContext* context,
                                        grpc::ServerReaderWriter<v1::ToImageResponse, v1::ToImageRequest>* stream) {
  return rpc::serve_frames<v1::ToImageRequest, v1::ToImageResponse>(
      context, stream, {"to_image", &metrics_, &drain_},
      [this](const v1::ToImageOpen& message, v1::ConversionOpened* opened) {
        const auto session = open(message.setup(), false, message.dtype(), opened);
        session->add_obstacles(message.obstacles());
        return [session, this](const v1::ToImageRequest& request, v1::ImageFrame* response) {
          session->encode(request, response);
          if (response->out_of_range() > 0) metrics_.count("out_of_range_values", response->out_of_range());
        };
      });
}

grpc::Status ConversionService::ToMesh(grpc::ServerContext* context,
                                       grpc::ServerReaderWriter<v1::ToMeshResponse, v1::ToMeshRequest>* stream) {
  return rpc::serve_frames<v1::ToMeshRequest, v1::ToMeshResponse>(
      context, stream, {"to_mesh", &metrics_, &drain_},
      [this](const v1::ToMeshOpen& message, v1::ConversionOpened* opened) {
        const auto session = open(message.setup(), true, v1::Tensor::DTYPE_FLOAT32, opened);
        return
            [session](const v1::ImageFrame& request, v1::MeshFrame* response) { session->decode(request, response); };
      });
}

}  // namespace pleat::conversion
