// Kernels for every processor that the build supports.
#include "services/superres/cpu/kernels.hpp"

namespace pleat::superres::cpu {
namespace {

constexpr int kLanes = 8;
using Vec = float __attribute__((vector_size(32)));

#include "services/superres/cpu/kernels_impl.hpp"

}  // namespace

const Kernels kBaseFloat32{
    "AVX2", kLanes, 4, 2 * kLanes, transform<Float32>, convolve3<Float32>, convolve1<Float32>, store_elements<Float32>};

}  // namespace pleat::superres::cpu
