// Fold.Fold: an open message and frames.
#include <cstdlib>

#include "common/frame/messages.hpp"
#include "services/fold/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::FoldRequest>& messages) {
  pleat::fuzz::run_session(messages, [](const pleat::v1::FoldOpen& open, const auto& for_frames) {
    pleat::fold::Session session(open, pleat::fuzz::fold_limits());
    for_frames([&](const pleat::v1::FoldFrame& frame) {
      pleat::v1::FoldedFrame folded;
      session.fold(frame, &folded);
      const pleat::v1::FoldState& state = folded.state();
      const auto positions = pleat::positions_from_message(state.positions(), -1, "positions");
      const auto velocities = pleat::positions_from_message(state.velocities(), positions.rows(), "velocities");
      if (positions.rows() == 0 || !positions.allFinite() || !velocities.allFinite()) std::abort();
    });
  });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::FoldRequest, run)
