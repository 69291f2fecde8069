// Conversion.ToImage: an open message and coarse frames.
#include <cstdlib>

#include "services/conversion/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::ToImageRequest>& messages) {
  pleat::fuzz::run_session(messages, [](const auto& open, const auto& for_frames) {
    pleat::conversion::MapCache cache(0);
    pleat::conversion::Session session(open.setup(), pleat::fuzz::conversion_limits(), cache);
    pleat::v1::ConversionOpened opened;
    session.describe(true, &opened);
    for_frames([&](const pleat::v1::Frame& frame) {
      pleat::v1::ImageFrame image;
      session.to_image(frame, &image);
      const auto texels = static_cast<std::int64_t>(opened.coarse_width()) * opened.coarse_height();
      if (image.image().values_size() != 9 * texels) std::abort();
    });
  });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::ToImageRequest, run)
