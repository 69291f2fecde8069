#include "services/evaluation/session_method.hpp"

#include "common/frame/messages.hpp"
#include "services/cli/enhance_session.hpp"

namespace pleat::evaluation {

Method session_method(const std::shared_ptr<grpc::Channel>& channel, const std::string& address,
                      const MeshPair& topology, const std::string& model, bool refine) {
  const int rounds = subdivision_rounds(topology);
  return {"pleat:" + model, [=](const MethodInput& input, const auto& sink) {
            cli::EnhanceSessionOptions open;
            open.coarse = topology.coarse;
            open.model = model;
            open.frame_time_s = input.frame_time_s;
            open.obstacles = input.obstacle_shapes;
            open.skip_refinement = !refine;
            open.subdivision_rounds = static_cast<std::uint32_t>(rounds);
            cli::EnhanceSession session(channel, address, open);
            session.run(
                input.frames,
                [&](std::uint64_t k) {
                  return cli::CoarseInput{input.coarse(k), input.obstacles(k)};
                },
                [&](const v1::EnhancedFrame& frame, const cli::CoarseInput&) {
                  MethodFrame out;
                  out.positions = positions_from_message(frame.fine(), topology.fine.vertex_count());
                  for (const v1::StageTime& time : frame.stage_times()) out.ms.emplace_back(time.stage(), time.ms());
                  out.refined = refine;
                  out.penetrations_before = frame.report().penetrations_before();
                  out.self_intersections_before = frame.report().self_intersections_before();
                  sink(frame.fine().index(), out);
                });
          }};
}

}  // namespace pleat::evaluation
