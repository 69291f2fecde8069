// Counts what a program takes from the heap, for tests of hot paths. Replaces malloc and its kin (operator new and
// Eigen use them): include it in one source file of a test program.
#pragma once

#include <atomic>
#include <cerrno>
#include <cstddef>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
// Sanitizers replace malloc themselves.
#define PLEAT_COUNTS_ALLOCATIONS 0
#else
#define PLEAT_COUNTS_ALLOCATIONS 1
#endif

namespace pleat::test {
inline std::atomic<std::size_t> allocations{0};
}  // namespace pleat::test

#if PLEAT_COUNTS_ALLOCATIONS
extern "C" {
// glibc's own functions, by the names that it keeps for this.
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  ++pleat::test::allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++pleat::test::allocations;
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  ++pleat::test::allocations;
  return __libc_realloc(memory, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  ++pleat::test::allocations;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) {
  ++pleat::test::allocations;
  *memory = __libc_memalign(alignment, size);
  return *memory == nullptr ? ENOMEM : 0;
}
}
#endif
