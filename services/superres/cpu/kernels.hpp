// Convolutions on one processor core, for images of features that lie channel after channel at each pixel.
//
// A 3x3 convolution is Winograd's F(4x4, 3x3) (Lavin and Gray 2016): a tile of 4x4 outputs needs 36 products a channel
// pair instead of 144. Features are transformed once and serve every later layer of a dense block, which reads all
// features before it; the sums over channels are 36 small matrix products.
#pragma once

#include <cstddef>
#include <cstdint>

namespace pleat::superres::cpu {

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
  float* scratch;  ///< kScratch floats
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
  void (*transform)(const Geometry& geometry, const TransformCall& call, int begin, int end);
  void (*convolve3)(const Geometry& geometry, const ConvolutionCall& call, int begin, int end);
  void (*convolve1)(const Geometry& geometry, const ConvolutionCall& call, int begin, int end);
  void (*store)(const float* values, void* elements, int count);  ///< count: a multiple of lanes
};

inline constexpr int kLargestRows = 12;       ///< rows of the largest matrix product
inline constexpr int kLargestOutputs = 1024;  ///< of a 1x1 convolution
inline constexpr std::size_t kScratch = static_cast<std::size_t>(kPoints) * kLargestRows * 32;

extern const Kernels kBaseFloat32;  ///< the instruction set that the whole program is built for
extern const Kernels kAvx512Float32;
extern const Kernels kAvx512Bfloat16;

}  // namespace pleat::superres::cpu
