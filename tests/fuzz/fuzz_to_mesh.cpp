// Conversion.ToMesh: an open message and fine images.
#include <cmath>
#include <cstdlib>

#include "common/base/error.hpp"
#include "services/conversion/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::ToMeshRequest>& messages) {
  if (messages.empty()) return;
  pleat::conversion::MapCache cache(0);
  try {
    pleat::conversion::Session session(messages[0].open().setup(), pleat::fuzz::conversion_limits(), cache);
    pleat::v1::ConversionOpened opened;
    session.describe(true, &opened);
    for (std::size_t i = 1; i < messages.size(); ++i) {
      try {
        pleat::v1::MeshFrame mesh;
        session.to_mesh(messages[i].frame(), &mesh);
        if (mesh.fine().positions_size() != opened.fine().rest_positions_size()) std::abort();
        for (const float x : mesh.fine().positions()) {
          if (!std::isfinite(x)) std::abort();
        }
      } catch (const pleat::Error&) {
        // A FrameError; the stream goes on.
      }
    }
  } catch (const pleat::Error&) {
    // The session is refused.
  }
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::ToMeshRequest, run)
