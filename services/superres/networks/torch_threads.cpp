#include "services/superres/networks/torch_threads.hpp"

#include <ATen/Parallel.h>

// Null where LibTorch has another BLAS.
extern "C" __attribute__((weak)) void openblas_set_num_threads(int threads);

namespace pleat::superres {

void set_torch_threads(int threads) {
  at::set_num_threads(threads);
  if (openblas_set_num_threads != nullptr) openblas_set_num_threads(1);
}

}  // namespace pleat::superres
