#include "common/base/freed_memory.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstring>
#include <memory>

namespace pleat {
namespace {

long page_faults() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

/// Takes and frees an array as large as a fine mesh of 180,000 vertices.
void touch_and_free() {
  constexpr std::size_t kBytes = 180'000 * 3 * 8;
  const auto array = std::make_unique<unsigned char[]>(kBytes);
  // Read back, so that nobody leaves it out.
  volatile unsigned char sum = 0;
  for (std::size_t i = 0; i < kBytes; i += 4096) sum = sum + array[i];
}

TEST(FreedMemory, IsTakenAgainWithoutTouchingNewPages) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer's own allocator";
#endif
  keep_freed_memory();
  touch_and_free();
  touch_and_free();
  const long before = page_faults();
  for (int i = 0; i < 20; ++i) touch_and_free();
  EXPECT_LT(page_faults() - before, 1000) << "one array has 1,054 pages";
}

}  // namespace
}  // namespace pleat
