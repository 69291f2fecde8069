// What this process does with memory that it frees.
#pragma once

namespace pleat {

/// Keeps freed memory for the next allocation instead of giving it back to the system: a frame's arrays are of one size
/// again and again, and the first touch of a page costs more than filling it (docs/transport.md). At most 64 MiB of
/// each of the allocator's arenas lie idle, of which there is one for four processors. Call before threads start. Does
/// nothing where the allocator isn't glibc's.
void keep_freed_memory();

/// Gives the pages of freed memory back to the system that lie between what is in use: sessions that end leave such
/// holes, and the next ones rarely fit. Takes milliseconds for a gigabyte; whoever allocates meanwhile waits. Does
/// nothing where the allocator isn't glibc's.
void give_back_holes();

/// The same without that limit, and one arena for all threads: for programs that take gigabytes for every step and are
/// alone on their machine, as trainings are.
void keep_all_freed_memory();

}  // namespace pleat
