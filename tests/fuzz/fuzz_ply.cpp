// Stanford PLY, text and binary: polygons of finite vertices, and a topology that is one.
#include <algorithm>
#include <cmath>

#include "common/mesh/mesh.hpp"
#include "common/mesh/ply.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto file = fuzz::file_with(data, size, "mesh.ply");
  fuzz::accept_errors([&] {
    PolygonMesh mesh = read_ply(file);
    const auto finite = [](float value) { return std::isfinite(value); };
    fuzz::must(std::all_of(mesh.positions.begin(), mesh.positions.end(), finite));
    fuzz::must(std::all_of(mesh.uv.begin(), mesh.uv.end(), finite));
    std::size_t begin = 0;
    for (const std::size_t end : mesh.ends) {
      fuzz::must(end >= begin + 3 && end <= mesh.corners.size());
      begin = end;
    }
    for (const MeshUse use : {MeshUse::kGarment, MeshUse::kObstacle}) {
      fuzz::accept_errors([&] { validate_topology(to_topology(mesh, "mesh.ply", use), "mesh.ply"); });
    }
  });
  return 0;
}
