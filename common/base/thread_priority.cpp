#include "common/base/thread_priority.hpp"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace pleat {

void lower_thread_priority() {
  // Linux keeps this value for each thread, whatever POSIX says of processes.
  constexpr int kNice = 19;
  const auto thread = static_cast<id_t>(syscall(SYS_gettid));
  if (getpriority(PRIO_PROCESS, thread) < kNice) setpriority(PRIO_PROCESS, thread, kNice);
}

}  // namespace pleat
