#include "services/simulation/service.hpp"

#include <spdlog/spdlog.h>

#include <cmath>
#include <memory>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/rpc/priority.hpp"
#include "common/rpc/status.hpp"
#include "common/rpc/stream.hpp"
#include "common/scene/animation_parts.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::simulation {
namespace {

Mode mode_of(v1::SimulateOpen::Fine fine) {
  switch (fine) {
    case v1::SimulateOpen::FINE_NONE:
      return Mode::kCoarse;
    case v1::SimulateOpen::FINE_TRACKED:
      return Mode::kTrackedFine;
    case v1::SimulateOpen::FINE_FREE:
      return Mode::kFreeFine;
    default:
      throw_invalid_argument("open.fine: unknown value " + std::to_string(static_cast<int>(fine)));
  }
}

void check_size(const Scene& scene, Mode mode, std::int64_t limit) {
  const double splits = mode == Mode::kCoarse ? 1 : std::pow(4.0, scene.subdivision_rounds);
  const double vertices = static_cast<double>(scene.garment.vertex_count()) * splits;
  if (vertices > static_cast<double>(limit)) {
    throw Error(ErrorCode::kResourceExhausted,
                "scene '" + scene.name + "': about " + std::to_string(static_cast<std::int64_t>(vertices)) +
                    " vertices, more than this service's limit of " + std::to_string(limit));
  }
}

// The parts of the animations that the scene announces.
void receive_animations(v1::Scene& scene, grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>& stream) {
  AnimationAssembly assembly(scene, "scene");
  v1::SimulateRequest request;
  while (!assembly.complete()) {
    if (!stream.Read(&request)) throw_invalid_argument("the stream ended too early: " + assembly.describe_missing());
    if (!request.has_animation()) {
      throw_invalid_argument("after `open` the parts of its animations must follow: " + assembly.describe_missing());
    }
    assembly.add(request.animation());
  }
}

Simulation open_session(const v1::SimulateOpen& open, const ServiceOptions& options) {
  const Mode mode = mode_of(open.fine());
  Scene scene = scene_from_message(open.scene());
  scene.threads = options.threads;
  check_size(scene, mode, options.max_vertices);
  Simulation simulation(std::move(scene), mode);
  if (!open.checkpoint().empty()) {
    simulation.restore(std::as_bytes(std::span(open.checkpoint().data(), open.checkpoint().size())));
  }
  return simulation;
}

void describe(const Simulation& simulation, v1::SimulateOpened* opened) {
  *opened->mutable_coarse() = to_message(simulation.coarse());
  if (simulation.mode() != Mode::kCoarse) *opened->mutable_fine() = to_message(simulation.fine());
  opened->mutable_feature_vertices()->Add(simulation.feature_vertices().begin(), simulation.feature_vertices().end());
  for (const ObstacleShape& shape : simulation.obstacle_shapes()) *opened->add_obstacles() = to_message(shape);
  opened->set_next_index(simulation.next_index());
}

void fill(const SimulatedFrame& frame, v1::SimulatedFrame* message) {
  to_message(frame.coarse, message->mutable_coarse());
  if (frame.fine) to_message(*frame.fine, message->mutable_fine());
  for (const ObstacleFrame& obstacle : frame.obstacles) *message->add_obstacles() = to_message(obstacle);
  for (const std::string& warning : frame.warnings) message->add_warnings(warning);
  if (frame.report.pinched_vertices > 0 || frame.report.obstacle_lag_m > 0) {
    message->mutable_pinch()->set_vertices(static_cast<std::uint32_t>(frame.report.pinched_vertices));
    message->mutable_pinch()->set_depth_m(static_cast<float>(frame.report.obstacle_lag_m));
  }
  const auto add_time = [&](const char* stage, double ms) {
    auto* time = message->add_stage_times();
    time->set_stage(stage);
    time->set_ms(ms);
  };
  add_time("simulation", frame.times.coarse_ms);
  if (frame.fine) add_time("simulation.fine", frame.times.fine_ms);
  add_time("simulation.assembly", frame.times.assembly_ms);
  add_time("simulation.solve", frame.times.solve_ms);
  add_time("simulation.contact", frame.times.contact_ms);
}

}  // namespace

grpc::Status SimulationService::Simulate(grpc::ServerContext* context,
                                         grpc::ServerReaderWriter<v1::SimulateResponse, v1::SimulateRequest>* stream) {
  return rpc::run_by_priority(*context, [&] {
    return rpc::guard([&]() -> grpc::Status {
      const telemetry::TraceScope trace(rpc::trace_of(*context));
      v1::SimulateRequest request;
      if (!stream->Read(&request)) return grpc::Status::OK;
      if (!request.has_open()) throw_invalid_argument("the first message of a stream must be `open`");
      const std::uint32_t window = rpc::checked_window(request.open().window());
      const std::uint32_t interval = request.open().checkpoint_interval();
      drain_.require_none();
      const rpc::detail::SessionCount session(&metrics_);
      receive_animations(*request.mutable_open()->mutable_scene(), *stream);
      Simulation simulation = open_session(request.open(), options_);
      request.Clear();
      simulation.stop_when([context] { return context->IsCancelled(); });
      const std::string name = simulation.scene().name;
      const auto frames = static_cast<std::uint64_t>(simulation.scene().frames);
      spdlog::info("scene '{}': {} frames from {}, {} coarse vertices", name, frames, simulation.next_index(),
                   simulation.coarse().vertex_count());

      v1::SimulateResponse response;
      describe(simulation, response.mutable_opened());
      if (!stream->Write(response)) return {grpc::StatusCode::CANCELLED, "the client has gone"};
      rpc::PacedWriter<v1::SimulateRequest, v1::SimulateResponse> writer(context, stream, window,
                                                                         simulation.next_index(), &drain_);

      while (simulation.next_index() < frames && !writer.stopped() && !context->IsCancelled()) {
        drain_.require_none();
        const SimulatedFrame frame = simulation.next_frame();
        for (const std::string& warning : frame.warnings) spdlog::warn("scene '{}': {}", name, warning);
        response.Clear();
        fill(frame, response.mutable_frame());
        const std::uint64_t index = frame.coarse.index;
        if (interval > 0 && (index + 1) % interval == 0) {
          const auto bytes = simulation.checkpoint();
          response.mutable_frame()->set_checkpoint(bytes.data(), bytes.size());
        }
        metrics_.frame_done("simulation", (frame.times.coarse_ms + frame.times.fine_ms) * 1e-3, true);
        if (frame.report.impacts > 0) metrics_.count("impacts", static_cast<double>(frame.report.impacts));
        if (frame.report.cut_steps > 0) metrics_.count("cut_steps", static_cast<double>(frame.report.cut_steps));
        if (!writer.write(index, response)) break;
      }
      if (context->IsCancelled()) return {grpc::StatusCode::CANCELLED, "the client has gone"};
      writer.close();
      return grpc::Status::OK;
    });
  });
}

}  // namespace pleat::simulation
