#include "services/evaluation/session_method.hpp"

#include "common/base/signals.hpp"
#include "common/client/adapter/adapter.hpp"

namespace pleat::evaluation {

Method session_method(std::shared_ptr<const client::Client> client, const MeshPair& topology, const std::string& model,
                      bool refine) {
  const int rounds = subdivision_of(topology).rounds;
  return {"pleat:" + model, [=, client = std::move(client)](const MethodInput& input, const auto& sink) {
            client::EnhanceSession session =
                client->enhance({.coarse = client::from_topology(topology.coarse),
                                 .model = model,
                                 .frame_time_s = input.frame_time_s,
                                 .obstacles = client::from_shapes(input.obstacle_shapes),
                                 .skip_refinement = !refine,
                                 .subdivision_rounds = static_cast<std::uint32_t>(rounds)});
            session.run(
                input.frames,
                [&](std::uint64_t k) {
                  if (interrupted()) throw Error(ErrorCode::kCancelled, "interrupted");
                  client::CoarseFrame frame;
                  frame.index = k;
                  frame.time_s = input.frame_time_s * static_cast<double>(k);
                  frame.positions = client::from_positions(input.coarse(k));
                  frame.obstacles = client::from_obstacles(input.obstacles(k));
                  return frame;
                },
                [&](const client::EnhancedFrame& frame, const client::CoarseFrame&) {
                  if (frame.error) throw *frame.error;
                  MethodFrame out;
                  out.positions = client::to_positions(frame.positions);
                  for (const client::StageTime& time : frame.stage_times) out.ms.emplace_back(time.stage, time.ms);
                  out.refined = refine;
                  out.penetrations_before = frame.report.penetrations_before;
                  out.self_intersections_before = frame.report.self_intersections_before;
                  sink(frame.index, out);
                });
          }};
}

}  // namespace pleat::evaluation
