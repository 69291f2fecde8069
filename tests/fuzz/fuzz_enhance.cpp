// Coordinator.Enhance: an open message and frames, before stages that do simple arithmetic.
#include "common/frame/messages.hpp"
#include "services/coordinator/service.hpp"
#include "tests/fuzz/message_fuzzer.hpp"
#include "tests/fuzz/stream_fuzzer.hpp"
#include "tests/support/fake_coordinator.hpp"

namespace {

pleat::coordinator::CoordinatorOptions options_before(pleat::testing::FakeStages& stages) {
  auto options = pleat::testing::coordinator_options(stages);
  options.live.max_vertices = 2000;  // larger meshes would only take time
  return options;
}

void run(const std::vector<pleat::v1::EnhanceRequest>& messages) {
  static pleat::testing::FakeStages stages;
  static pleat::coordinator::CoordinatorService service(options_before(stages), nullptr);
  static const pleat::fuzz::ServedInProcess served(&service);
  static const auto stub = pleat::v1::Coordinator::NewStub(served.channel());
  pleat::fuzz::run_stream<pleat::v1::EnhanceRequest, pleat::v1::EnhanceResponse>(
      [](grpc::ClientContext* context) { return stub->Enhance(context); }, messages,
      [](const auto& answer) {
        if (answer.has_frame() && !pleat::positions_from_message(answer.frame().fine()).allFinite()) std::abort();
        return true;
      });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::EnhanceRequest, run)
