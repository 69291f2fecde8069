// Per-texel parts of a network around its convolutions: what it reads of a coarse image, and what becomes of its
// answer.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "services/superres/mesh_base.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres::cpu {

/// A coarse image in planes (9, height, width).
struct Planes {
  const float* data;
  int height, width;
  const float* row(int channel, int y) const { return data + (channel * height + y) * width; }
};

/// Features in the cloth's own axes: local_frame() of services/superres/network.hpp, standardised and clamped.
class LocalFeatures {
 public:
  /// rest: (3, height, width) metres; mean, deviation: (17).
  LocalFeatures(const Normalization& normalization, std::span<const float> rest, int height, int width,
                std::span<const float> mean, std::span<const float> deviation);

  /// Rows [begin, end). features: the texel (y, x) begins at ((y + 1) row + x + 1) stride; axes: (9, height, width).
  void compute(const Planes& image, int begin, int end, float* features, int row, int stride, float* axes) const;

 private:
  void positions(const Planes& image, int y, float* target) const;

  Normalization normalization_;
  int height_, width_;
  std::vector<float> rest_;                 ///< (3, h, w)
  std::vector<float> length_u_, length_v_;  ///< 1 / squared length of a texel's step in the rest mesh, (h, w)
  std::vector<float> mean_, scale_;         ///< (17)
};

/// Values at the 4 x 4 fine texels of a coarse one, row by row.
using Block = std::array<float, kScale * kScale>;

/// Bilinear upsampling of one plane at coarse texel (y, x), with the texel-centre convention.
void upsample_block(const float* plane, int height, int width, int y, int x, Block& block);

/// The barycentrically upsampled coarse mesh (MeshBase), laid out for one pass over the coarse texels.
class UpsampledMesh {
 public:
  /// texels, weights: (vertices, count): vertex values from texels. corners, corner_weights: (3, 16 height width).
  UpsampledMesh(std::span<const std::int64_t> texels, std::span<const float> weights, std::size_t vertices,
                std::span<const std::int64_t> corners, std::span<const float> corner_weights, int height, int width);

  UpsampledMesh(const MeshBase& base, int height, int width);

  std::size_t vertices() const { return vertices_; }
  /// Values of the vertices [begin, end) around 0.5: (vertices, channels).
  void vertex_values(const Planes& image, int channels, std::size_t begin, std::size_t end, float* values) const;
  /// Adds the mesh's value of a channel at a coarse texel.
  void add(const float* values, int channels, int channel, std::size_t texel, Block& block) const;
  /// The whole fine image (9, 4 height, 4 width).
  void image(const Planes& image, float* target) const;

 private:
  struct Entry {
    std::int32_t texel;
    float weight;
  };
  std::size_t vertices_;
  std::vector<std::uint32_t> rows_;  ///< (vertices + 1) into entries_
  std::vector<Entry> entries_;
  std::vector<std::uint32_t> blocks_;  ///< (texels + 1) into block_vertices_, block_weights_
  std::vector<std::uint32_t> block_vertices_;
  std::vector<Block> block_weights_;
};

}  // namespace pleat::superres::cpu
