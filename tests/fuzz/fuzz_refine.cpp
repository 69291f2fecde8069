// Refinement.Refine: an open message and frames.
#include <cstdlib>

#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/refinement/judge.hpp"
#include "services/refinement/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

constexpr std::size_t kCountedPairs = 50'000;

// What the report says must be what the judge finds.
void check(const pleat::refinement::RefinementReport& report, const pleat::v1::RefineFrame& request,
           const pleat::v1::RefinedFrame& refined, const pleat::Faces& faces,
           const std::vector<pleat::ObstacleShape>& shapes) {
  const pleat::Positions positions = pleat::positions_from_message(refined.fine());
  if (!positions.allFinite()) std::abort();
  if (report.pairs_after + report.penetrations_after > report.pairs_before + report.penetrations_before) std::abort();
  if (report.pairs_after < kCountedPairs &&
      report.pairs_after != pleat::refinement::count_self_intersections(positions, faces)) {
    std::abort();
  }
  const auto obstacles = pleat::obstacles_from_messages(request.obstacles(), shapes);
  if (report.penetrations_after == 0 &&
      pleat::refinement::count_penetrations(positions, faces, shapes, obstacles) != 0) {
    std::abort();
  }
}

void run(const std::vector<pleat::v1::RefineRequest>& messages) {
  pleat::fuzz::run_session(messages, [](const pleat::v1::RefineOpen& open, const auto& for_frames) {
    pleat::refinement::Session session(open, pleat::fuzz::refinement_limits());
    const pleat::Topology coarse = pleat::from_message(open.coarse());
    const int rounds = open.has_subdivision_rounds() ? static_cast<int>(open.subdivision_rounds()) : 2;
    const pleat::Faces faces = pleat::subdivide(coarse, rounds).fine.faces;
    std::vector<pleat::ObstacleShape> shapes;
    for (const auto& obstacle : open.obstacles()) shapes.push_back(pleat::from_message(obstacle));
    for_frames([&](const pleat::v1::RefineFrame& frame) {
      pleat::v1::RefinedFrame refined;
      const pleat::refinement::RefinementReport& report = session.refine(frame, &refined);
      check(report, frame, refined, faces, shapes);
    });
  });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::RefineRequest, run)
