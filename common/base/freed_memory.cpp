#include "common/base/freed_memory.hpp"

#include <algorithm>
#include <cstdlib>  // says which C library it is
#include <limits>

#include "common/base/parallel.hpp"

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
  // Of its own accord eight for each processor: sessions come and go in other threads each time, and what one of them
  // has left in its arena is of no use to the next.
  mallopt(M_ARENA_MAX, std::max(1, static_cast<int>(available_processors() / 4)));
#endif
}

void give_back_holes() {
#ifdef __GLIBC__
  malloc_trim(64 << 20);  // of the end of the first arena as much stays as in keep_freed_memory()
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
