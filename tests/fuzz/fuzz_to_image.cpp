// Conversion.ToImage: an open message and coarse frames.
#include <cmath>
#include <cstdlib>

#include "common/base/error.hpp"
#include "services/conversion/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::ToImageRequest>& messages) {
  if (messages.empty()) return;
  pleat::conversion::MapCache cache(0);
  try {
    pleat::conversion::Session session(messages[0].open().setup(), pleat::fuzz::conversion_limits(), cache);
    pleat::v1::ConversionOpened opened;
    session.describe(true, &opened);
    for (std::size_t i = 1; i < messages.size(); ++i) {
      try {
        pleat::v1::ImageFrame image;
        session.to_image(messages[i].frame(), &image);
        const auto texels = static_cast<std::int64_t>(opened.coarse_width()) * opened.coarse_height();
        if (image.image().values_size() != 9 * texels) std::abort();
      } catch (const pleat::Error&) {
        // A FrameError; the stream goes on.
      }
    }
  } catch (const pleat::Error&) {
    // The session is refused.
  }
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::ToImageRequest, run)
