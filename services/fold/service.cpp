#include "services/fold/service.hpp"

#include <spdlog/spdlog.h>

#include <memory>

#include "common/rpc/stream.hpp"

namespace pleat::fold {

void FoldService::count(std::uint64_t index, const FoldReport& report) {
  metrics_.count("fold_steps", static_cast<double>(report.steps));
  metrics_.count("fold_layer_contacts", static_cast<double>(report.layer_contacts));
  metrics_.count("fold_obstacle_contacts", static_cast<double>(report.obstacle_contacts));
  if (!report.restarted) return;
  metrics_.count("fold_restarts");
  if (index > 0) spdlog::info("frame {}: begun anew from the upsampled coarse cloth", index);
}

grpc::Status FoldService::Fold(grpc::ServerContext* context,
                               grpc::ServerReaderWriter<v1::FoldResponse, v1::FoldRequest>* stream) {
  return rpc::serve_frames<v1::FoldRequest, v1::FoldResponse>(
      context, stream, {"fold", &metrics_, &drain_}, [this](const v1::FoldOpen& open, v1::FoldOpened* opened) {
        const auto session = std::make_shared<Session>(open, options_);
        session->describe(opened);
        return [session, this](const v1::FoldFrame& request, v1::FoldedFrame* response) {
          count(request.coarse().index(), session->fold(request, response));
        };
      });
}

}  // namespace pleat::fold
