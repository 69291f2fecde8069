#include "services/superres/kernels/kernels.hpp"

#include <sys/syscall.h>
#include <unistd.h>

#include "common/base/error.hpp"

namespace pleat::superres::kernels {

bool has_bfloat16() {
#ifdef PLEAT_HAVE_AVX512
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
         __builtin_cpu_supports("avx512bf16");
#else
  return false;
#endif
}

bool has_tiles() {
#ifdef PLEAT_HAVE_AVX512
  // Linux gives a process the registers of the tiles when it asks for them, for all of its threads.
  constexpr int kRequestState = 0x1023, kTileData = 18;
  static const bool granted = has_bfloat16() && __builtin_cpu_supports("amx-tile") &&
                              __builtin_cpu_supports("amx-bf16") &&
                              ::syscall(SYS_arch_prctl, kRequestState, kTileData) == 0;
  return granted;
#else
  return false;
#endif
}

const Kernels& bfloat16_kernels(bool base_instructions) {
#ifdef PLEAT_HAVE_AVX512
  if (!base_instructions && has_tiles()) return kAmxBfloat16;
  if (has_bfloat16()) return kAvx512Bfloat16;
#endif
  static_cast<void>(base_instructions);
  throw Error(ErrorCode::kFailedPrecondition, "bfloat16: this processor has no AVX512-BF16");
}

const Kernels& float32_kernels(bool base_instructions) {
#ifdef PLEAT_HAVE_AVX512
  if (!base_instructions && has_bfloat16()) return kAvx512Float32;
#endif
  static_cast<void>(base_instructions);
  return kBaseFloat32;
}

}  // namespace pleat::superres::kernels
