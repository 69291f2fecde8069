#include "services/refinement/service.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/rpc/stream.hpp"
#include "services/refinement/refiner.hpp"

namespace pleat::refinement {
namespace {

constexpr std::uint32_t kDefaultRounds = 2;

struct Session {
  std::vector<ObstacleShape> obstacles;
  Eigen::Index coarse_vertices = 0, fine_vertices = 0;
  std::unique_ptr<Refiner> refiner;
  RefinedMesh result;  // reused; the frames of a stream come one after the other
};

std::shared_ptr<Session> open_session(const v1::RefineOpen& open, const ServiceOptions& options,
                                      v1::RefineOpened* opened) {
  const Topology coarse = from_message(open.coarse(), "open.coarse");
  const std::uint32_t rounds = open.has_subdivision_rounds() ? open.subdivision_rounds() : kDefaultRounds;
  if (rounds > 5) throw_invalid_argument("open.subdivision_rounds: at most 5, not " + std::to_string(rounds));
  const double vertices = static_cast<double>(coarse.vertex_count()) * std::pow(4.0, rounds);
  if (vertices > static_cast<double>(options.max_vertices)) {
    throw Error(ErrorCode::kResourceExhausted,
                "open.coarse: about " + std::to_string(static_cast<std::int64_t>(vertices)) +
                    " fine vertices, more than this service's limit of " + std::to_string(options.max_vertices));
  }
  const Subdivision subdivision = subdivide(coarse, static_cast<int>(rounds));
  const std::string hash = topology_hash(subdivision.fine);
  if (open.has_fine() && open.fine().faces_size() > 0) {
    if (topology_hash(from_message(open.fine(), "open.fine")) != hash) {
      throw Error(ErrorCode::kFailedPrecondition,
                  "open.fine: refinement needs the fine mesh that splitting the coarse edges " +
                      std::to_string(rounds) + " times gives, and this is another one");
    }
  }
  auto session = std::make_shared<Session>();
  for (const auto& obstacle : open.obstacles()) {
    session->obstacles.push_back(
        from_message(obstacle, "open.obstacles[" + std::to_string(session->obstacles.size()) + "]"));
  }
  RefinementOptions refinement;
  refinement.bisections = options.bisections;
  refinement.threads = options.threads;
  if (open.has_clearance_m()) refinement.clearance_m = static_cast<double>(open.clearance_m());
  session->coarse_vertices = coarse.vertex_count();
  session->fine_vertices = subdivision.fine.vertex_count();
  session->refiner = std::make_unique<Refiner>(coarse, subdivision, session->obstacles, refinement);
  opened->set_fine_hash(hash);
  spdlog::info("session: {} coarse and {} fine vertices, {} obstacles, clearance {} m", session->coarse_vertices,
               session->fine_vertices, session->obstacles.size(), refinement.clearance_m);
  return session;
}

std::uint32_t count_of(std::size_t value) {
  return static_cast<std::uint32_t>(std::min<std::size_t>(value, std::numeric_limits<std::uint32_t>::max()));
}

void fill(const RefinementReport& report, v1::RefinementReport* message) {
  message->set_self_intersections_before(count_of(report.pairs_before));
  message->set_self_intersections_after(count_of(report.pairs_after));
  message->set_penetrations_before(count_of(report.penetrations_before));
  message->set_penetrations_after(count_of(report.penetrations_after));
  message->set_zones(count_of(report.zones));
  message->set_rounds(count_of(report.rounds));
  message->set_vertices_moved(count_of(report.vertices_moved));
  message->set_largest_move_m(static_cast<float>(report.largest_move_m));
  message->set_input_intersects(report.input_intersects);
}

void refine(Session& session, const v1::RefineFrame& request, v1::RefinedFrame* response, telemetry::Metrics& metrics) {
  if (request.coarse().index() != request.fine().index()) {
    throw_invalid_argument("frame: coarse index " + std::to_string(request.coarse().index()) + " and fine index " +
                           std::to_string(request.fine().index()) + " differ");
  }
  const Positions coarse = positions_from_message(request.coarse(), session.coarse_vertices, "frame.coarse");
  const Positions fine = positions_from_message(request.fine(), session.fine_vertices, "frame.fine");
  const std::vector<ObstacleFrame> obstacles =
      obstacles_from_messages(request.obstacles(), session.obstacles, "frame.obstacles");
  const RefinedMesh& result = session.result;
  session.refiner->refine(coarse, fine, obstacles, session.result);
  v1::Frame* refined = response->mutable_fine();
  refined->set_index(request.fine().index());
  refined->set_time_s(request.fine().time_s());
  to_message(result.positions, refined->mutable_positions());
  fill(result.report, response->mutable_report());
  if (result.report.zones > 0) metrics.count("impact_zones", static_cast<double>(result.report.zones));
  if (!result.report.clean()) {
    metrics.count("unclean_frames");
    spdlog::warn("frame {}: {} self-intersections and {} penetrations remain{}", request.fine().index(),
                 result.report.pairs_after, result.report.penetrations_after,
                 result.report.input_intersects ? "; the coarse frame itself is not clean" : "");
  }
}

}  // namespace

grpc::Status RefinementService::Refine(grpc::ServerContext* context,
                                       grpc::ServerReaderWriter<v1::RefineResponse, v1::RefineRequest>* stream) {
  return rpc::serve_frames<v1::RefineRequest, v1::RefineResponse>(
      context, stream, {"refinement", &metrics_}, [this](const v1::RefineOpen& open, v1::RefineOpened* opened) {
        auto session = open_session(open, options_, opened);
        return [session, this](const v1::RefineFrame& request, v1::RefinedFrame* response) {
          refine(*session, request, response, metrics_);
        };
      });
}

}  // namespace pleat::refinement
