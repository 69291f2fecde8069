// Simulation.Simulate: an open message, parts of animations, acknowledgements.
#include "common/frame/messages.hpp"
#include "services/simulation/service.hpp"
#include "tests/fuzz/message_fuzzer.hpp"
#include "tests/fuzz/stream_fuzzer.hpp"

namespace {

constexpr int kAnswers = 3;  // `opened` and two frames

void check(const pleat::v1::Frame& frame) {
  if (!pleat::positions_from_message(frame).allFinite()) std::abort();
}

void run(const std::vector<pleat::v1::SimulateRequest>& messages) {
  static pleat::telemetry::Metrics metrics("fuzz");
  static pleat::simulation::SimulationService service({.threads = 1, .max_vertices = 300}, metrics);
  static const pleat::fuzz::ServedInProcess served(&service);
  static const auto stub = pleat::v1::Simulation::NewStub(served.channel());
  int answers = 0;
  pleat::fuzz::run_stream<pleat::v1::SimulateRequest, pleat::v1::SimulateResponse>(
      [](grpc::ClientContext* context) { return stub->Simulate(context); }, messages,
      [&](const auto& answer) {
        if (answer.has_frame()) check(answer.frame().coarse());
        if (answer.has_frame() && answer.frame().has_fine()) check(answer.frame().fine());
        return ++answers < kAnswers;
      });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::SimulateRequest, run)
