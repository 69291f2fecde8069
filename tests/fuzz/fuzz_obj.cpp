// Wavefront OBJ: a topology that is one, and that comes back with the same bits after it was written.
#include <sstream>

#include "common/mesh/mesh.hpp"
#include "common/mesh/obj.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

namespace {

using namespace pleat;

void read(const std::string& text, MeshUse use) {
  std::istringstream stream(text);
  const Topology mesh = read_obj(stream, "mesh.obj", use, {.max_vertices = 20'000, .max_faces = 40'000});
  validate_topology(mesh, "mesh.obj");
  const auto file = fuzz::file_with(nullptr, 0, "written.obj");
  write_obj(file, mesh);
  const Topology again = read_obj(file, use);
  fuzz::must(again.rest_positions == mesh.rest_positions && again.faces == mesh.faces && again.uv == mesh.uv &&
             again.uv_faces == mesh.uv_faces);
  fuzz::must(read_obj_frame(file, mesh) == mesh.rest_positions);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  fuzz::accept_errors([&] { read(text, MeshUse::kGarment); });
  fuzz::accept_errors([&] { read(text, MeshUse::kObstacle); });
  return 0;
}
