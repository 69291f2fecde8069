// Kernels for every processor that the build supports.
#include "services/superres/kernels/kernels.hpp"

namespace pleat::superres::kernels {
namespace {

constexpr int kLanes = 8;
using Vec = float __attribute__((vector_size(32)));

#include "services/superres/kernels/kernels_impl.hpp"

}  // namespace

const Kernels kBaseFloat32 = make_kernels<Float32>("AVX2");

}  // namespace pleat::superres::kernels
