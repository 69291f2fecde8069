// Kernels for processors with AVX-512 and its bfloat16 products, and for those that also multiply whole matrices of
// bfloat16 (AMX). Compiled with flags of its own: call them only where the processor has what they need.
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

  static constexpr int kRows = kMost;
  static void begin_products(int) {}
  static void end_products() {}
  template <int N>
  static void multiply(int rows, const Product<Element>& p) {
    multiply_rows<Bfloat16, N>(rows, p);
  }
};

/// The same, with the products of convolutions in AMX's tiles: registers of 16 rows of 64 bytes. The sums of up to 32
/// rows and 32 columns fill four of them, so that each tile that is loaded serves two products.
struct TiledBfloat16 : Bfloat16 {
  static constexpr int kTileRows = 16, kTileSteps = 16;  ///< a step is a pair of factors
  static constexpr int kRows = 2 * kTileRows;

  /// Sizes of the tiles for products of `rows` rows: 0 and 1 sums of the first 16, 2 and 3 of the others; 4 and 5 the
  /// rows' factors, 6 and 7 those of the columns.
  static void begin_products(int rows) {
    struct alignas(64) {
      unsigned char palette = 1, start = 0, reserved[14] = {};
      unsigned short bytes[16] = {};
      unsigned char rows[16] = {};
    } sizes;
    const int upper = rows < kTileRows ? rows : kTileRows, lower = rows - upper;
    for (int t = 0; t < 8; ++t) {
      const int height = t >= 6 ? kTileSteps : t == 2 || t == 3 || t == 5 ? lower : upper;
      // A tile without rows is not set up, and not used.
      sizes.rows[t] = static_cast<unsigned char>(height);
      sizes.bytes[t] = height > 0 ? 64 : 0;
    }
    _tile_loadconfig(&sizes);
  }
  static void end_products() { _tile_release(); }

  template <int N>
  static void multiply(int rows, const Product<Element>& p) {
    if (p.steps % kTileSteps != 0) return multiply_in_registers<N>(rows, p);
    const bool both = rows > kTileRows;
    const long a_bytes = 2 * p.a_row, b_bytes = 2 * p.b_step, c_bytes = 4 * p.c_row;
    const Element* below = p.a + kTileRows * p.a_row;
    _tile_zero(0);
    if (N == 2) _tile_zero(1);
    if (both) _tile_zero(2);
    if (both && N == 2) _tile_zero(3);
    for (int i = 0; i < p.steps; i += kTileSteps) {
      const Element* b = p.b + i * p.b_step;
      _tile_loadd(4, p.a + i * p.a_step, a_bytes);
      _tile_loadd(6, b, b_bytes);
      _tile_dpbf16ps(0, 4, 6);
      if (N == 2) {
        _tile_loadd(7, b + kLanes * kGroup, b_bytes);
        _tile_dpbf16ps(1, 4, 7);
      }
      if (both) {
        _tile_loadd(5, below + i * p.a_step, a_bytes);
        _tile_dpbf16ps(2, 5, 6);
        if (N == 2) _tile_dpbf16ps(3, 5, 7);
      }
    }
    _tile_stored(0, p.c, c_bytes);
    if (N == 2) _tile_stored(1, p.c + kLanes, c_bytes);
    float* c = p.c + kTileRows * p.c_row;
    if (both) _tile_stored(2, c, c_bytes);
    if (both && N == 2) _tile_stored(3, c + kLanes, c_bytes);
  }

  /// For channels that are no multiple of 32.
  template <int N>
  static void multiply_in_registers(int rows, Product<Element> p) {
    for (; rows > 0; rows -= kMost) {
      multiply_rows<Bfloat16, N>(rows < kMost ? rows : kMost, p);
      p.a += kMost * p.a_row;
      p.c += kMost * p.c_row;
    }
  }
};

}  // namespace

const Kernels kAvx512Float32 = make_kernels<Float32>("AVX-512");
const Kernels kAvx512Bfloat16 = make_kernels<Bfloat16>("AVX-512 bfloat16");
const Kernels kAmxBfloat16 = make_kernels<TiledBfloat16>("AMX bfloat16");

}  // namespace pleat::superres::kernels
