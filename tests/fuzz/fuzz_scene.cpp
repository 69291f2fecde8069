// Scene files: a scene that can be written as JSON, or an error.
#include "common/frame/scene_json.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr const char* kGarment =
      "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n";
  static const std::filesystem::path folder =
      fuzz::file_with(reinterpret_cast<const std::uint8_t*>(kGarment), std::string_view(kGarment).size(), "cloth.obj")
          .parent_path();
  const std::string text(reinterpret_cast<const char*>(data), size);
  // Whatever a mutation names must be looked for among the fuzzer's own files.
  if (text.find('/') != std::string::npos || text.find("..") != std::string::npos) return 0;
  fuzz::accept_errors([&] {
    std::vector<std::string> notes;
    const v1::Scene scene = presentation::parse_scene(text, "scene.json", folder, {.notes = &notes});
    fuzz::must(!scene_json(scene).empty());
  });
  return 0;
}
