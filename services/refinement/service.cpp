#include "services/refinement/service.hpp"

#include <spdlog/spdlog.h>

#include <memory>

#include "common/rpc/stream.hpp"

namespace pleat::refinement {

void RefinementService::count(std::uint64_t index, const RefinementReport& report) {
  if (report.zones > 0) metrics_.count("impact_zones", static_cast<double>(report.zones));
  if (report.clean()) return;
  metrics_.count("unclean_frames");
  spdlog::warn("frame {}: {} self-intersections and {} penetrations remain{}", index, report.pairs_after,
               report.penetrations_after, report.input_intersects ? "; the coarse frame itself is not clean" : "");
}

grpc::Status RefinementService::Refine(grpc::ServerContext* context,
                                       grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) {
  return rpc::serve_frames<v1::RefineRequest, v1::RefineResponse>(
      context, stream, {"refinement", &metrics_, &drain_},
      [this](const v1::RefineOpen& open, v1::RefineOpened* opened) {
        const auto session = std::make_shared<Session>(open, options_);
        session->describe(opened);
        return [session, this](const v1::RefineFrame& request, v1::RefinedFrame* response) {
          count(request.fine().index(), session->refine(request, response));
        };
      });
}

}  // namespace pleat::refinement
