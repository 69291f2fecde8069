// Conversion.ToImage: an open message and coarse frames.
#include <cstdlib>

#include "services/conversion/session.hpp"
#include "tests/fuzz/limits.hpp"
#include "tests/fuzz/message_fuzzer.hpp"

namespace {

void run(const std::vector<pleat::v1::ToImageRequest>& messages) {
  pleat::fuzz::run_session(messages, [](const auto& open, const auto& for_frames) {
    pleat::conversion::RepresentationCache cache(0);
    pleat::conversion::Session session(open.setup(), pleat::fuzz::conversion_limits(), cache);
    pleat::v1::ConversionOpened opened;
    session.describe(true, &opened);
    session.add_obstacles(open.obstacles());
    for_frames([&](const pleat::v1::ToImageRequest& request) {
      pleat::v1::ImageFrame image;
      session.encode(request, &image);
      std::size_t values = static_cast<std::size_t>(request.earlier_size()) + 1;
      for (const std::uint32_t extent : opened.input_shape()) values *= extent;
      if (image.image().data().size() != sizeof(float) * values) std::abort();
    });
  });
}

}  // namespace

PLEAT_MESSAGE_FUZZER(pleat::v1::ToImageRequest, run)
