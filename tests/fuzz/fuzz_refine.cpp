// Refinement.Refine: an open message and frames.
#include <cstdlib>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/refinement/judge.hpp"
#include "services/refinement/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

constexpr std::size_t kCountedPairs = 50'000;

// What the report says must be what the judge finds.
void check(const pleat::RefinementReport& report, const pleat::v1::RefineFrame& request,
           const pleat::v1::RefinedFrame& refined, const pleat::Faces& faces,
           const std::vector<pleat::ObstacleShape>& shapes) {
  const pleat::Positions positions = pleat::positions_from_message(refined.fine());
  if (!positions.allFinite()) std::abort();
  if (report.pairs_after + report.penetrations_after > report.pairs_before + report.penetrations_before) std::abort();
  if (report.pairs_after < kCountedPairs && report.pairs_after != pleat::count_self_intersections(positions, faces)) {
    std::abort();
  }
  const auto obstacles = pleat::obstacles_from_messages(request.obstacles(), shapes);
  if (report.penetrations_after == 0 && pleat::count_penetrations(positions, faces, shapes, obstacles) != 0) {
    std::abort();
  }
}

void run(const std::vector<pleat::v1::RefineRequest>& messages) {
  if (messages.empty()) return;
  const pleat::v1::RefineOpen& open = messages[0].open();
  try {
    pleat::refinement::Session session(open, pleat::fuzz::refinement_limits());
    const pleat::Topology coarse = pleat::from_message(open.coarse());
    const int rounds = open.has_subdivision_rounds() ? static_cast<int>(open.subdivision_rounds()) : 2;
    const pleat::Faces faces = pleat::subdivide(coarse, rounds).fine.faces;
    std::vector<pleat::ObstacleShape> shapes;
    for (const auto& obstacle : open.obstacles()) shapes.push_back(pleat::from_message(obstacle));
    for (std::size_t i = 1; i < messages.size(); ++i) {
      try {
        pleat::v1::RefinedFrame refined;
        const pleat::RefinementReport& report = session.refine(messages[i].frame(), &refined);
        check(report, messages[i].frame(), refined, faces, shapes);
      } catch (const pleat::Error&) {
        // A FrameError; the stream goes on.
      }
    }
  } catch (const pleat::Error&) {
    // The session is refused.
  }
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::RefineRequest, run)
