// The fold step as a stage of the pipeline: the one whose frames depend on the frame before.
#pragma once

#include <memory>
#include <utility>

#include "pleat/v1/coordinator.pb.h"
#include "pleat/v1/fold.grpc.pb.h"
#include "pleat/v1/scene.pb.h"
#include "services/coordinator/pipeline_frame.hpp"

namespace pleat::coordinator {

struct FoldRpc {
  using Service = v1::Fold;
  using Request = v1::FoldRequest;
  using Response = v1::FoldResponse;
  static constexpr bool kFineMesh = true;
  /// Frames go one after the other through one stream, and it remembers what the last one left.
  using Memory = FoldMemory;

  static void start(Service::Stub& stub, grpc::ClientContext* context,
                    grpc::ClientBidiReactor<Request, Response>* call) {
    stub.async()->Fold(context, call);
  }
  static void absorb(PipelineFrame& frame, v1::FoldedFrame& answer);
  static void take_back(PipelineFrame& frame);
  /// The frame's fine positions, if it has any, are what the step is drawn to.
  static void prepare(PipelineFrame& frame);

  static std::shared_ptr<const Memory> memory_of(const PipelineFrame& frame) { return frame.fold_memory; }
  /// The first request of a stream that was opened again, with what the frame before left. Without memory of that frame
  /// the request is as it was: the cloth begins anew, as it did for the service that broke off.
  static std::shared_ptr<const google::protobuf::Message> resumed(
      std::shared_ptr<const google::protobuf::Message> request, const Memory& memory);
};

/// What the fold step has to know of a scene: material, handles, gravity, wind, frame time, thickness.
v1::FoldOpen fold_open_of(const v1::Scene& scene);
/// The same of a live session. Values are checked by the service.
v1::FoldOpen fold_open_of(const v1::EnhanceOpen& open);

}  // namespace pleat::coordinator
