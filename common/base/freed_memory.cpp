#include "common/base/freed_memory.hpp"

#include <cstdlib>  // says which C library it is

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

}  // namespace pleat
