// The archive of a bundle, as far as it is checked before LibTorch sees it.
#include "services/superres/bundle/archive.hpp"
#include "tests/fuzz/reader_fuzzer.hpp"

using namespace pleat;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto file = fuzz::file_with(data, size, "bundle.pt");
  fuzz::accept_errors([&] { superres::check_archive(file.string()); });
  return 0;
}
