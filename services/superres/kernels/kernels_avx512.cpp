// Kernels for processors with AVX-512 and its bfloat16 products. Compiled with flags of its own: call them only where
// the processor has both.
#include <immintrin.h>

#include "services/superres/kernels/kernels.hpp"

namespace pleat::superres::kernels {
namespace {

constexpr int kLanes = 16;
using Vec = float __attribute__((vector_size(64)));

#include "services/superres/kernels/kernels_impl.hpp"

/// Features in bfloat16, sums in float32. Weights lie in pairs: (k / 2, columns, 2).
struct Bfloat16 {
  using Element = unsigned short;
  static constexpr int kGroup = 2;
  // The forms without a mask trip GCC's warning about uninitialised values.
  static constexpr __mmask16 kAll = 0xFFFF;
  static Vec read(const Element* p) {
    const __m256i bits = _mm256_load_si256(reinterpret_cast<const __m256i*>(p));
    return reinterpret_cast<Vec>(_mm512_maskz_slli_epi32(kAll, _mm512_maskz_cvtepu16_epi32(kAll, bits), 16));
  }
  static void write(Element* p, Vec v) {
    _mm256_store_si256(reinterpret_cast<__m256i*>(p), reinterpret_cast<__m256i>(_mm512_cvtneps_pbh(v)));
  }

  using Factors = __m512bh;
  static Factors factors(const Element* p) { return reinterpret_cast<__m512bh>(_mm512_load_si512(p)); }
  static Factors factor(const Element* p) {
    int pair;
    __builtin_memcpy(&pair, p, sizeof pair);
    return reinterpret_cast<__m512bh>(_mm512_set1_epi32(pair));
  }
  static Vec add_products(Vec sum, Factors x, Factors w) { return _mm512_dpbf16_ps(sum, x, w); }

  static __m512i bits(Vec v) {
    return _mm512_maskz_cvtepu16_epi32(kAll, reinterpret_cast<__m256i>(_mm512_cvtneps_pbh(v)));
  }
  /// Two members of a group, alternating.
  static void write_group(Element* p, const Vec* v) {
    _mm512_store_si512(p, _mm512_or_si512(bits(v[0]), _mm512_maskz_slli_epi32(kAll, bits(v[1]), 16)));
  }

  /// Rows in pairs: weight (i, j) of a block is element ((i / 2) width + j) 2 + i % 2.
  static void write_weights(Element* block, int i, int width, int column, Vec v) {
    alignas(32) Element values[kLanes];
    write(values, v);
    Element* place = block + (i / 2 * width + column) * 2 + i % 2;
    for (int j = 0; j < kLanes; ++j) place[2 * j] = values[j];
  }
};

}  // namespace

const Kernels kAvx512Float32 = make_kernels<Float32>("AVX-512");
const Kernels kAvx512Bfloat16 = make_kernels<Bfloat16>("AVX-512 bfloat16");

}  // namespace pleat::superres::kernels
