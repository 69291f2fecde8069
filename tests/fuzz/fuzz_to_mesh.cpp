// Conversion.ToMesh: an open message and fine images.
#include <cmath>
#include <cstdlib>

#include "services/conversion/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::ToMeshRequest>& messages) {
  pleat::fuzz::run_session(messages, [](const auto& open, const auto& for_frames) {
    pleat::conversion::RepresentationCache cache(0);
    pleat::conversion::Session session(open.setup(), pleat::fuzz::conversion_limits(), cache);
    pleat::v1::ConversionOpened opened;
    session.describe(true, &opened);
    for_frames([&](const pleat::v1::ImageFrame& image) {
      pleat::v1::MeshFrame mesh;
      session.decode(image, &mesh);
      if (mesh.fine().positions_size() != opened.fine().rest_positions_size()) std::abort();
      for (const float x : mesh.fine().positions()) {
        if (!std::isfinite(x)) std::abort();
      }
    });
  });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::ToMeshRequest, run)
