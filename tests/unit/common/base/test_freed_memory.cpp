#include "common/base/freed_memory.hpp"

#include <gtest/gtest.h>
#include <malloc.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <latch>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "common/base/parallel.hpp"

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

/// Arenas that the allocator has made, as it says itself.
std::size_t arenas() {
  char* text = nullptr;
  std::size_t size = 0, count = 0;
  std::FILE* file = open_memstream(&text, &size);
  malloc_info(0, file);
  std::fclose(file);
  for (std::string_view rest(text, size); (size = rest.find("<heap nr=")) != rest.npos; rest.remove_prefix(size + 1)) {
    ++count;
  }
  std::free(text);
  return count;
}

/// 0 if threads that allocate at the same time share the arenas that there should be.
[[noreturn]] void share_arenas() {
  keep_freed_memory();
  constexpr int kThreads = 32;
  std::latch all(kThreads);
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) {
    threads.emplace_back([&] {
      const auto own = std::make_unique<std::string>(10'000, 'x');
      all.arrive_and_wait();
    });
  }
  for (std::thread& thread : threads) thread.join();
  std::exit(arenas() <= std::max<std::size_t>(1, available_processors() / 4) ? 0 : 1);
}

// Otherwise memory grows with every thread that a session has, and sessions that come and go leave holes in all of
// them.
TEST(FreedMemoryDeathTest, ThreadsShareIt) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer's own allocator";
#endif
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(share_arenas(), testing::ExitedWithCode(0), "");
}

long resident_pages() {
  std::ifstream file("/proc/self/statm");
  long size = 0, resident = 0;
  file >> size >> resident;
  return resident;
}

TEST(FreedMemory, HolesAreGivenBack) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer's own allocator";
#endif
  keep_freed_memory();
  constexpr std::size_t kBlocks = 2000, kBytes = 40'000;
  std::vector<std::string> ended, going_on;
  for (std::size_t i = 0; i < kBlocks; ++i) {
    ended.emplace_back(kBytes, 'x');
    going_on.emplace_back(100, 'x');
  }
  const long before = resident_pages();
  ended = {};
  EXPECT_GT(resident_pages(), before - 1000) << "kept for the next allocation";
  give_back_holes();
  EXPECT_LT(resident_pages(), before - static_cast<long>(kBlocks * 8)) << "each hole has nine whole pages or eight";
}

}  // namespace
}  // namespace pleat
