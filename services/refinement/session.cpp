#include "services/refinement/session.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <limits>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/mesh/fine_size.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::refinement {
namespace {

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

}  // namespace

Session::Session(const v1::RefineOpen& open, const SessionOptions& options) {
  const Topology coarse = from_message(open.coarse(), "open.coarse");
  const SubdivisionSpec spec = subdivision_from(open);
  check_fine_size(coarse.vertex_count(), spec.rounds, options.max_vertices, "open.coarse");
  const Subdivision subdivision = subdivide(coarse, spec);
  fine_hash_ = topology_hash(subdivision.fine);
  if (open.has_fine() && open.fine().faces_size() > 0 &&
      topology_hash(from_message(open.fine(), "open.fine")) != fine_hash_) {
    throw Error(ErrorCode::kFailedPrecondition,
                "open.fine: refinement needs the fine mesh that splitting the coarse edges " +
                    std::to_string(spec.rounds) + " times gives, and this is another one");
  }
  for (const auto& obstacle : open.obstacles()) {
    obstacles_.push_back(from_message(obstacle, "open.obstacles[" + std::to_string(obstacles_.size()) + "]"));
  }
  RefinementOptions refinement;
  refinement.bisections = options.bisections;
  refinement.threads = options.threads;
  if (open.has_clearance_m()) refinement.clearance_m = static_cast<double>(open.clearance_m());
  coarse_vertices_ = coarse.vertex_count();
  fine_vertices_ = subdivision.fine.vertex_count();
  if (open.judge_only()) {
    coarse_faces_ = coarse.faces;
    fine_faces_ = subdivision.fine.faces;
  } else {
    refiner_ = std::make_unique<Refiner>(coarse, subdivision, obstacles_, refinement);
  }
  spdlog::info("session: {} coarse and {} fine vertices, {} obstacles, clearance {} m", coarse_vertices_,
               fine_vertices_, obstacles_.size(), refinement.clearance_m);
}

const RefinementReport& Session::refine(const v1::RefineFrame& request, v1::RefinedFrame* response) {
  if (request.coarse().index() != request.fine().index()) {
    throw_invalid_argument("frame: coarse index " + std::to_string(request.coarse().index()) + " and fine index " +
                           std::to_string(request.fine().index()) + " differ");
  }
  const Positions coarse = positions_from_message(request.coarse(), coarse_vertices_, "frame.coarse");
  const Positions fine = positions_from_message(request.fine(), fine_vertices_, "frame.fine");
  const std::vector<ObstacleFrame> obstacles =
      obstacles_from_messages(request.obstacles(), obstacles_, "frame.obstacles");
  if (refiner_ != nullptr)
    refiner_->refine(coarse, fine, obstacles, result_);
  else
    judge(coarse, fine, obstacles);
  v1::Frame* refined = response->mutable_fine();
  refined->set_index(request.fine().index());
  refined->set_time_s(request.fine().time_s());
  to_message(result_.positions, refined->mutable_positions());
  fill(result_.report, response->mutable_report());
  return result_.report;
}

void Session::judge(const Positions& coarse, const Positions& fine, const std::vector<ObstacleFrame>& obstacles) {
  result_.positions = fine;
  RefinementReport report;
  report.pairs_before = report.pairs_after = count_self_intersections(fine, fine_faces_);
  report.penetrations_before = report.penetrations_after = count_penetrations(fine, fine_faces_, obstacles_, obstacles);
  report.input_intersects = count_self_intersections(coarse, coarse_faces_) > 0 ||
                            count_penetrations(coarse, coarse_faces_, obstacles_, obstacles) > 0;
  result_.report = report;
}

}  // namespace pleat::refinement
