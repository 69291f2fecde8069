#include "common/base/freed_memory.hpp"

#include <cstdlib>  // says which C library it is
#include <limits>

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace pleat {

void keep_freed_memory() {
#ifdef __GLIBC__
  // Larger blocks come from the system each time; more than this glibc doesn't take.
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
  mallopt(M_TOP_PAD, 1 << 20);
#endif
}

void keep_all_freed_memory() {
#ifdef __GLIBC__
  mallopt(M_MMAP_MAX, 0);  // whatever their size
  mallopt(M_TRIM_THRESHOLD, std::numeric_limits<int>::max());
  mallopt(M_ARENA_MAX, 1);
#endif
}

}  // namespace pleat
