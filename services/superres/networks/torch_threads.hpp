// How many threads LibTorch computes with.
#pragma once

namespace pleat::superres {

/// Of this process, from now on. A BLAS of its own that LibTorch calls (OpenBLAS) gets one thread: its others wait for
/// the next product in a busy loop, which takes a processor from whoever works, and products here are small.
void set_torch_threads(int threads);

}  // namespace pleat::superres
