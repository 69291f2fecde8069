// Which threads have the processors first.
#pragma once

namespace pleat {

/// From now on the calling thread, and those that it starts, get next to nothing of a processor that others want too.
/// It can't be undone. Does nothing where the system refuses.
void lower_thread_priority();

}  // namespace pleat
