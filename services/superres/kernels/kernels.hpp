// Convolutions on one processor core, for images of features that lie channel after channel at each pixel.
//
// A 3x3 convolution is Winograd's F(4x4, 3x3) (Lavin and Gray 2016): a tile of 4x4 outputs needs 36 products a channel
// pair instead of 144. Features are transformed once and serve every later layer of a dense block, which reads all
// features before it; the sums over channels are 36 small matrix products.
#pragma once

#include <cstddef>
#include <cstdint>

namespace pleat::superres::kernels {

inline constexpr int kTile = 4;     ///< outputs of a tile in a row
inline constexpr int kPoints = 36;  ///< values of a transformed tile: 6 x 6

/// The pixels of an image. Every feature image of one size shares it: pixel (y, x) begins at
/// ((y + 1) row + x + 1) stride, where `row` is tiles_x * kTile + 2. The border, one pixel wide and up to whole tiles,
/// is zero and stays so.
struct Geometry {
  int height = 0, width = 0;
  int tiles_y = 0, tiles_x = 0;
  int row = 0;

  Geometry() = default;
  Geometry(int h, int w)
      : height(h),
        width(w),
        tiles_y((h + kTile - 1) / kTile),
        tiles_x((w + kTile - 1) / kTile),
        row(tiles_x * kTile + 2) {}
  std::size_t pixels() const { return static_cast<std::size_t>(row) * static_cast<std::size_t>(tiles_y * kTile + 2); }
  std::size_t pixel(int y, int x) const {
    return static_cast<std::size_t>(y + 1) * static_cast<std::size_t>(row) + static_cast<std::size_t>(x) + 1;
  }
  std::size_t tiles() const { return static_cast<std::size_t>(tiles_y) * static_cast<std::size_t>(tiles_x); }
};

/// Winograd transform of channels [first, first + channels) of an image into channels from `target` on. Tile (ty, tx),
/// point p begins at (((ty - origin) tiles_x + tx) kPoints + p) transformed_stride.
struct TransformCall {
  const void* image;  ///< elements
  int image_stride;
  int first, channels;  ///< multiples of Kernels::lanes
  void* transformed;    ///< elements
  int transformed_stride;
  int target;
  int origin;  ///< tile row that lies first in `transformed`
};

/// A convolution of k input channels, from the first on, to n output channels.
struct ConvolutionCall {
  const void* input;    ///< 3x3: transformed tiles; 1x1: an image
  int input_stride;     ///< elements a point, or a pixel
  int origin;           ///< 3x3: as in TransformCall
  int k;                ///< even
  int n;                ///< a multiple of Kernels::lanes; 1x1: kLargestOutputs at most
  const void* weights;  ///< see Kernels::block
  const float* bias;    ///< (n)
  const float* add;     ///< image added before the activation, or null
  int add_stride;
  const float* slope;  ///< (n): factor of negative values (0: ReLU), or null: no activation
  float* output;       ///< image in float32, or null
  int output_stride;
  void* stored;  ///< image in elements, or null; 1x1: may lie in the input
  int stored_stride;
  void* also_stored;  ///< the same a second time, or null
  int also_stored_stride;
  const void* mask;  ///< image in elements: where it is not positive the result is 0 (gradient of ReLU), or null
  int mask_stride;
  float* scratch;  ///< kScratch floats
};

/// What the gradient of a weight is summed from, for channels [first, first + channels) of an image. `group` tiles (or
/// pixels) lie together: plane p, group g, channel c, member s is element
/// p plane + (g stride + target + c) group + s.
struct GroupCall {
  const void* image;  ///< elements
  int image_stride;
  int first, channels;  ///< multiples of Kernels::lanes
  void* groups;         ///< elements
  std::size_t plane;
  int stride;  ///< channels of a group
  int target;
};

/// sums[p][i][j] = sum over the groups of a[p][.][i] b[p][.][j], for i < k and j < n.
struct CorrelateCall {
  const void *a, *b;  ///< as GroupCall made them, from the first channel on
  std::size_t a_plane, b_plane;
  int a_stride, b_stride;
  int points, groups;
  int k, n;     ///< n a multiple of Kernels::lanes
  float* sums;  ///< (points, k, n)
};

/// One instruction set and type of the stored features. All pointers are aligned to 64 bytes. Calls work on the tile
/// rows [begin, end). Their outputs may be read there without waiting for other threads, except by `transform`, which
/// reads one pixel beyond.
///
/// Weights: for each point (3x3) or once (1x1), blocks of `block` output channels, the last of which may have `lanes`;
/// a block is (k, columns) in float32 and (k / 2, columns, 2) in bfloat16.
struct Kernels {
  const char* name;
  int lanes;    ///< floats in a vector
  int element;  ///< bytes of a stored feature: 4 float32, 2 bfloat16
  int block;
  int group;  ///< tiles or pixels of a group: 1, in bfloat16 2
  void (*transform)(const Geometry& geometry, const TransformCall& call, int begin, int end);
  void (*convolve3)(const Geometry& geometry, const ConvolutionCall& call, int begin, int end);
  void (*convolve1)(const Geometry& geometry, const ConvolutionCall& call, int begin, int end);
  void (*store)(const float* values, void* elements, int count);  ///< count: a multiple of lanes

  // For training.
  /// The same, with 0 where mask is not positive.
  void (*store_masked)(const float* values, const void* mask, void* elements, int count);
  /// Winograd weights from taps (9, k, n), with n a multiple of lanes.
  void (*pack3)(const float* taps, int k, int n, void* weights);
  /// Transformed tiles of a whole image, as groups of planes; a last tile without a mate stays 0.
  void (*group_inputs)(const Geometry& geometry, const GroupCall& call);
  /// The same for the image of an output's gradient: transposed output transform.
  void (*group_outputs)(const Geometry& geometry, const GroupCall& call);
  /// The pixels of an image row by row, without borders, in one plane.
  void (*group_pixels)(const Geometry& geometry, const GroupCall& call);
  void (*correlate)(const CorrelateCall& call);
  /// Adds the gradient of taps (9, k, n) that belongs to sums (36, k, n).
  void (*add_taps)(const float* sums, int k, int n, float* taps);
};

inline constexpr int kLargestRows = 32;       ///< rows of the largest matrix product
inline constexpr int kLargestOutputs = 1024;  ///< of a 1x1 convolution
inline constexpr std::size_t kScratch = static_cast<std::size_t>(kPoints) * kLargestRows * 32;

/// True if this processor has AVX-512 with bfloat16 products, and this build knows them.
bool has_bfloat16();
/// True if has_bfloat16(), and the processor has AMX's tiles of bfloat16 and the system lets this process use them.
bool has_tiles();
/// The best of this processor, or those without tiles. Throws kFailedPrecondition without has_bfloat16().
const Kernels& bfloat16_kernels(bool base_instructions);
/// The best of this processor, or those that the whole program is built for.
const Kernels& float32_kernels(bool base_instructions);

extern const Kernels kBaseFloat32;  ///< the instruction set that the whole program is built for
extern const Kernels kAvx512Float32;
extern const Kernels kAvx512Bfloat16;
extern const Kernels kAmxBfloat16;

}  // namespace pleat::superres::kernels
