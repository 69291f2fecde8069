// Meshes with their frames (Alembic, glTF, USD text): as many finite points in every frame as the mesh has vertices.
// The first byte chooses the format.
#include <algorithm>
#include <array>

#include "common/mesh/animated_mesh.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  constexpr std::array<const char*, 3> kNames{"frames.abc", "frames.glb", "frames.usda"};
  const auto file = fuzz::file_with(data + 1, size - 1, kNames[data[0] % kNames.size()]);
  fuzz::accept_errors([&] {
    const auto frames = open_animated_mesh(file);
    for (std::size_t i = 0; i < std::min<std::size_t>(frames->frame_count(), 4); ++i) {
      fuzz::accept_errors([&] {
        const Positions positions = frames->positions(i);
        fuzz::must(static_cast<std::size_t>(positions.size()) == frames->mesh().positions.size() &&
                   positions.allFinite());
      });
    }
    fuzz::accept_errors([&] { to_topology(frames->mesh(), "frames", MeshUse::kGarment); });
  });
  return 0;
}
