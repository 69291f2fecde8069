#include "services/fold/session.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/mesh/fine_size.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/fold/default_material.hpp"
#include "services/simulation/material_messages.hpp"

namespace pleat::fold {
namespace {

std::uint32_t count_of(std::size_t value) {
  return static_cast<std::uint32_t>(std::min<std::size_t>(value, std::numeric_limits<std::uint32_t>::max()));
}

Eigen::Vector3d vector_from(const google::protobuf::RepeatedField<double>& values, const std::string& field,
                            const Eigen::Vector3d& otherwise) {
  if (values.empty()) return otherwise;
  if (values.size() != 3) throw_invalid_argument(field + ": " + std::to_string(values.size()) + " values instead of 3");
  return {values[0], values[1], values[2]};
}

/// Ranges are the library's to check.
FoldOptions options_from(const v1::FoldOpen& open) {
  FoldOptions options;
  options.material = simulation::material_from_message(open.material(), default_material_json(), "open.material");
  if (open.frame_time_s() != 0) options.frame_time_s = open.frame_time_s();
  options.gravity = vector_from(open.gravity(), "open.gravity", options.gravity);
  if (open.wind().has_density()) options.air_density = open.wind().density();
  options.air_velocity = vector_from(open.wind().velocity(), "open.wind.velocity", options.air_velocity);
  if (open.has_clearance_m()) options.clearance_m = static_cast<double>(open.clearance_m());
  if (open.has_thickness_m()) options.thickness_m = static_cast<double>(open.thickness_m());
  const v1::FoldSettings& settings = open.settings();
  if (settings.has_frequency()) options.frequency = settings.frequency();
  if (settings.has_step_s()) options.step_s = settings.step_s();
  if (settings.has_restart_m()) options.restart_m = settings.restart_m();
  return options;
}

void fill(const FoldReport& report, v1::FoldedFrame* response) {
  v1::FoldReport& message = *response->mutable_report();
  message.set_steps(count_of(static_cast<std::size_t>(report.steps)));
  message.set_layer_contacts(count_of(report.layer_contacts));
  message.set_obstacle_contacts(count_of(report.obstacle_contacts));
  message.set_restarted(report.restarted);
  v1::StageTime& time = *response->add_stage_times();
  time.set_stage("fold.contact");
  time.set_ms(report.contact_ms);
}

}  // namespace

Session::Session(const v1::FoldOpen& open, const SessionOptions& options) {
  const SubdivisionSpec spec = subdivision_from(open);
  check_fine_size(open.coarse().rest_positions_size() / 3, spec.rounds, options.max_vertices, "open.coarse");
  const Topology coarse = from_message(open.coarse(), "open.coarse");
  validate_material_coordinates(coarse, "open.coarse");
  const FoldOptions fold = options_from(open);
  for (const auto& obstacle : open.obstacles()) {
    obstacles_.push_back(from_message(obstacle, "open.obstacles[" + std::to_string(obstacles_.size()) + "]"));
  }
  coarse_vertices_ = coarse.vertex_count();
  holds_ = holds_from(open, coarse_vertices_);
  const Subdivision subdivision = subdivide(coarse, spec);
  fine_hash_ = topology_hash(subdivision.fine);
  fine_vertices_ = subdivision.fine.vertex_count();
  step_ = std::make_unique<FoldStep>(coarse, subdivision, obstacles_, fold);
  spdlog::info("session: {} coarse and {} fine vertices, {} obstacles, {} handles", coarse_vertices_, fine_vertices_,
               obstacles_.size(), holds_.size());
}

FoldReport Session::fold(const v1::FoldFrame& request, v1::FoldedFrame* response) {
  const Frame coarse = from_message(request.coarse(), coarse_vertices_, "frame.coarse");
  if (coarse.velocities.rows() == 0) throw_invalid_argument("frame.coarse.velocities: are missing");
  const std::vector<ObstacleFrame> obstacles =
      obstacles_from_messages(request.obstacles(), obstacles_, "frame.obstacles");
  const std::vector<std::uint32_t> held = held_at(coarse.time_s);
  FoldFrame frame{
      .coarse = coarse.positions, .coarse_velocities = coarse.velocities, .obstacles = obstacles, .held = held};
  Positions start;
  if (!request.start().empty()) {
    start = positions_from_message(request.start(), fine_vertices_, "frame.start");
    frame.start = &start;
  }
  FoldState other;  // of the request, or none
  if (request.has_state()) {
    other.positions = positions_from_message(request.state().positions(), fine_vertices_, "frame.state.positions");
    other.velocities = positions_from_message(request.state().velocities(), fine_vertices_, "frame.state.velocities");
  }
  const bool continues = !request.has_state() && last_index_ && coarse.index == *last_index_ + 1;
  const FoldReport report = step_->fold(frame, continues ? state_ : other);
  if (!continues) state_ = std::move(other);
  last_index_ = coarse.index;

  response->set_index(coarse.index);
  response->set_time_s(coarse.time_s);
  to_message(state_.positions, response->mutable_state()->mutable_positions());
  to_message(state_.velocities, response->mutable_state()->mutable_velocities());
  fill(report, response);
  return report;
}

std::vector<Session::Hold> Session::holds_from(const v1::FoldOpen& open, Eigen::Index vertices) {
  std::vector<Hold> holds;
  for (const v1::Handle& handle : open.handles()) {
    const std::string field = "open.handles[" + std::to_string(holds.size()) + "]";
    for (const std::uint32_t vertex : handle.vertices()) {
      if (static_cast<Eigen::Index>(vertex) >= vertices) {
        throw_invalid_argument(field + ".vertices: vertex " + std::to_string(vertex) + ", the mesh has " +
                               std::to_string(vertices));
      }
    }
    holds.push_back({{handle.vertices().begin(), handle.vertices().end()},
                     handle.start_s(),
                     handle.has_end_s() ? handle.end_s() : std::numeric_limits<double>::infinity()});
  }
  return holds;
}

std::vector<std::uint32_t> Session::held_at(double time_s) const {
  std::vector<std::uint32_t> held;
  for (const Hold& hold : holds_) {
    if (time_s >= hold.start_s && time_s < hold.end_s) {
      held.insert(held.end(), hold.vertices.begin(), hold.vertices.end());
    }
  }
  std::sort(held.begin(), held.end());
  held.erase(std::unique(held.begin(), held.end()), held.end());
  return held;
}

}  // namespace pleat::fold
