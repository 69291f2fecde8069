#include "common/base/freed_memory.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <array>
#include <memory>
#include <thread>

namespace pleat {
namespace {

long page_faults() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

/// Takes and frees arrays as large as fine meshes of 180,000 vertices: together more than the allocator keeps by
/// itself, which is twice the largest.
void touch_and_free() {
  constexpr std::size_t kBytes = 180'000 * 3 * 4;
  std::array<std::unique_ptr<unsigned char[]>, 4> arrays;
  for (auto& array : arrays) array = std::make_unique<unsigned char[]>(kBytes);
  // Read back, so that nobody leaves it out.
  volatile unsigned char sum = 0;
  for (const auto& array : arrays) sum = sum + array[kBytes / 2];
}

TEST(FreedMemory, IsTakenAgainWithoutTouchingNewPages) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer's own allocator";
#endif
  keep_freed_memory();
  long faults = 0;
  // The threads of a service have memory of their own, which the allocator gives back sooner.
  std::thread([&] {
    touch_and_free();
    touch_and_free();
    const long before = page_faults();
    for (int i = 0; i < 20; ++i) touch_and_free();
    faults = page_faults() - before;
  }).join();
  EXPECT_LT(faults, 1000) << "one array has 527 pages";
}

}  // namespace
}  // namespace pleat
