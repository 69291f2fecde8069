#include "services/evaluation/session_method.hpp"

#include <array>
#include <nlohmann/json.hpp>
#include <vector>

#include "common/base/signals.hpp"
#include "common/client/adapter/adapter.hpp"
#include "common/frame/detail.hpp"

namespace pleat::evaluation {
namespace {

// What the fold step has to know of a sequence's scene (services/dataset writes it).
void add_scene(const MethodInput& input, client::EnhanceOptions& options) {
  const auto scene = nlohmann::json::parse(input.scene, nullptr, false);
  try {
    for (const auto& handle : scene.value("handles", nlohmann::json::array())) {
      const auto vertices = handle.at("vertices").get<std::vector<std::uint32_t>>();
      options.held.insert(options.held.end(), vertices.begin(), vertices.end());
    }
    options.material_json = scene.value("materialJson", input.material);
    const auto wind = scene.value("wind", nlohmann::json::object());
    if (wind.contains("velocity")) options.wind_m_s = wind["velocity"].get<std::array<double, 3>>();
  } catch (const nlohmann::json::exception&) {
    throw Error(ErrorCode::kDataLoss, input.sequence + ": its scene is unreadable");
  }
}

std::string method_name(const SessionMethodOptions& options) {
  if (options.detail == v1::DETAIL_FOLD) return "fold";
  return (options.detail == v1::DETAIL_BOTH ? "both:" : "pleat:") + options.model;
}

}  // namespace

Method session_method(std::shared_ptr<const client::Client> client, const SessionMethodOptions& options) {
  return {method_name(options), [=, client = std::move(client)](const MethodInput& input, const auto& sink) {
            const int rounds = subdivision_of(*input.meshes).rounds;
            client::EnhanceOptions open{.coarse = client::from_topology(input.meshes->coarse),
                                        .model = options.model,
                                        .frame_time_s = input.frame_time_s,
                                        .obstacles = client::from_shapes(input.obstacle_shapes),
                                        .skip_refinement = !options.refine,
                                        .subdivision_rounds = static_cast<std::uint32_t>(rounds),
                                        .detail = options.detail};
            if (uses_fold(options.detail)) add_scene(input, open);
            client::EnhanceSession session = client->enhance(open);
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
                  out.refined = options.refine;
                  out.penetrations_before = frame.report.penetrations_before;
                  out.self_intersections_before = frame.report.self_intersections_before;
                  sink(frame.index, out);
                });
          }};
}

}  // namespace pleat::evaluation
