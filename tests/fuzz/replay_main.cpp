// Runs a fuzzer's function without libFuzzer: over files and folders once, which is the corpus as a test; or over
// mutations of them, blindly, for a compiler without libFuzzer and for libraries that Debian's clang can't compile.
// Usage: FUZZER FOLDER... [--mutate SECONDS]
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) __attribute__((weak));

namespace {

std::mt19937& random_bits() {
  static std::mt19937 random(1);
  return random;
}

using Bytes = std::vector<std::uint8_t>;

std::vector<Bytes> read_all(const std::filesystem::path& folder) {
  std::vector<Bytes> inputs;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    std::ifstream file(entry.path(), std::ios::binary);
    inputs.push_back({std::istreambuf_iterator<char>(file), {}});
    std::printf("%s\n", entry.path().c_str());
    std::fflush(stdout);
    LLVMFuzzerTestOneInput(inputs.back().data(), inputs.back().size());
  }
  return inputs;
}

}  // namespace

/// In place of libFuzzer's own: changes a few bytes, or cuts some off.
extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t) {
  auto& random = random_bits();
  if (size == 0) return 0;
  if (random() % 8 == 0) return random() % size;
  for (unsigned i = 1 + random() % 4; i > 0; --i) data[random() % size] = static_cast<std::uint8_t>(random());
  return size;
}

int main(int argc, char** argv) {
  std::vector<Bytes> inputs;
  double seconds = 0;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--mutate") == 0 && i + 1 < argc) {
      seconds = std::atof(argv[++i]);
      continue;
    }
    for (Bytes& input : read_all(argv[i])) inputs.push_back(std::move(input));
  }
  std::printf("%zu inputs\n", inputs.size());
  if (inputs.empty()) return 1;
  constexpr std::size_t kLargest = 150'000;
  std::size_t runs = 0;
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  for (; std::chrono::steady_clock::now() < end; ++runs) {
    Bytes input = inputs[random_bits()() % inputs.size()];
    const std::size_t size = std::min(input.size(), kLargest);
    input.resize(kLargest);
    const auto seed = static_cast<unsigned>(random_bits()());
    input.resize(LLVMFuzzerCustomMutator != nullptr ? LLVMFuzzerCustomMutator(input.data(), size, kLargest, seed)
                                                    : LLVMFuzzerMutate(input.data(), size, kLargest));
    LLVMFuzzerTestOneInput(input.data(), input.size());
  }
  if (runs > 0) std::printf("%zu mutations\n", runs);
  return 0;
}
