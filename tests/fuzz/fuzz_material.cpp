// Material files, and what a bundle says of itself (pleat.json): JSON both. The first byte chooses.
#include "services/simulation/material.hpp"
#include "services/superres/bundle/metadata.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string text(reinterpret_cast<const char*>(data) + 1, size - 1);
  fuzz::accept_errors([&] {
    if (data[0] % 2 == 0) {
      simulation::parse_material(text, "material.json");
    } else {
      const superres::Metadata metadata = superres::metadata_from_json(text, "bundle.pt");
      const std::string written = superres::to_json(metadata);
      fuzz::must(superres::to_json(superres::metadata_from_json(written, "bundle.pt")) == written);
    }
  });
  return 0;
}
