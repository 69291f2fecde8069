// Point caches (PC2, MDD, npy): as many finite points in every frame as announced. The first byte chooses the format.
#include <algorithm>
#include <array>

#include "services/presentation/input/point_sequence.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  constexpr std::array<const char*, 3> kNames{"points.pc2", "points.mdd", "points.npy"};
  const auto file = fuzz::file_with(data + 1, size - 1, kNames[data[0] % kNames.size()]);
  fuzz::accept_errors([&] {
    const auto points = presentation::open_points(file.string());
    points->warning();
    points->frame_time_s();
    const std::size_t frames = points->frame_count();
    for (std::size_t i = 0; i < std::min<std::size_t>(frames, 4); ++i) {
      fuzz::accept_errors([&] {
        const Positions positions = points->positions(i);
        fuzz::must(positions.rows() == points->point_count() && positions.allFinite());
      });
    }
    // Beyond the end is an error, never a frame.
    bool refused = false;
    try {
      points->positions(frames);
    } catch (const Error&) {
      refused = true;
    }
    fuzz::must(refused);
  });
  return 0;
}
