// SuperResolution.Upscale: an open message and images, to a bundle of geometry images that was made elsewhere and one
// of vertex features that remembers.
#include <filesystem>

#include "common/frame/messages.hpp"
#include "services/superres/service.hpp"
#include "tests/fuzz/message_fuzzer.hpp"
#include "tests/fuzz/stream_fuzzer.hpp"
#include "tests/support/temporary_folder.hpp"

namespace {

std::filesystem::path folder_of_bundles() {
  static const pleat::test::TemporaryFolder folder;
  const std::filesystem::path source = PLEAT_SOURCE_DIR;
  for (const char* bundle : {"tests/unit/services/superres/python_bundle.pt", "deploy/models/sheet-81.pt"}) {
    std::filesystem::copy_file(source / bundle, folder.path() / std::filesystem::path(bundle).filename());
  }
  return folder.path();
}

void run(const std::vector<pleat::v1::UpscaleRequest>& messages) {
  spdlog::set_level(spdlog::level::off);
  static pleat::telemetry::Metrics metrics("fuzz");
  static pleat::superres::SuperResolutionService service(
      {.models = folder_of_bundles().string(), .model = "sheet-81", .threads = 1, .batch_latency_ms = 0}, metrics);
  static const pleat::fuzz::ServedInProcess served(&service);
  static const auto stub = pleat::v1::SuperResolution::NewStub(served.channel());
  pleat::fuzz::run_stream<pleat::v1::UpscaleRequest, pleat::v1::UpscaleResponse>(
      [](grpc::ClientContext* context) { return stub->Upscale(context); }, messages,
      [](const auto& answer) {
        if (!answer.has_frame()) return true;
        const pleat::Tensor image = pleat::from_message(answer.frame().image(), "answer");
        if (image.values.empty()) std::abort();
        return true;
      });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::UpscaleRequest, run)
