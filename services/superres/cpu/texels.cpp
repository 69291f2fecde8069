#include "services/superres/cpu/texels.hpp"

#include <algorithm>
#include <cmath>

namespace pleat::superres::cpu {
namespace {

constexpr float kLargestFeature = 6;
constexpr float kSmallestLength = 1e-9F;

struct Vector {
  float x, y, z;
};
Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(float s, const Vector& a) { return {s * a.x, s * a.y, s * a.z}; }
float dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
Vector unit(const Vector& a) { return (1 / std::max(std::sqrt(dot(a, a)), kSmallestLength)) * a; }

/// Three planes of a row, with one texel more on each side.
struct Row {
  const float* data;
  int stride;
  Vector at(int x) const { return {data[x + 1], data[stride + x + 1], data[2 * stride + x + 1]}; }
};

/// Continues the ends linearly. target: (3, width + 2) with its middle filled.
void extend_ends(float* target, int width) {
  for (int c = 0; c < 3; ++c) {
    float* row = target + c * (width + 2);
    row[0] = 2 * row[1] - row[2];
    row[width + 1] = 2 * row[width] - row[width - 1];
  }
}

struct Steps {
  Vector u, v, uu, uv, vv;
};
Steps steps_at(const Row& above, const Row& here, const Row& below, int x) {
  const Vector p = here.at(x);
  return {0.5F * (here.at(x + 1) - here.at(x - 1)), 0.5F * (below.at(x) - above.at(x)),
          here.at(x + 1) - 2 * p + here.at(x - 1),
          0.25F * (below.at(x + 1) - below.at(x - 1) - above.at(x + 1) + above.at(x - 1)),
          below.at(x) - 2 * p + above.at(x)};
}

/// Rows y - 1, y and y + 1 of something that read(y, target) gives inside the image; continued linearly outside.
class Window {
 public:
  Window(int height, int width) : height_(height), width_(width), size_(3 * static_cast<std::size_t>(width + 2)) {
    values_.resize(4 * size_);
  }
  template <typename Read>
  void move_to(int y, const Read& read) {
    for (int k = -1; k <= 1; ++k) fill(y + k, slot(k), read);
  }
  Row row(int k) const { return {values_.data() + static_cast<std::size_t>(k + 1) * size_, width_ + 2}; }

 private:
  float* slot(int k) { return values_.data() + static_cast<std::size_t>(k + 1) * size_; }
  template <typename Read>
  void fill(int y, float* target, const Read& read) {
    if (y >= 0 && y < height_) {
      read(y, target);
    } else {
      // Twice the border row minus the one inside it.
      const int border = y < 0 ? 0 : height_ - 1, inside = y < 0 ? 1 : height_ - 2;
      float* other = values_.data() + 3 * size_;
      read(border, target);
      read(inside, other);
      for (std::size_t i = 0; i < size_; ++i) target[i] = 2 * target[i] - other[i];
    }
    extend_ends(target, width_);
  }
  int height_, width_;
  std::size_t size_;
  std::vector<float> values_;
};

}  // namespace

LocalFeatures::LocalFeatures(const Normalization& normalization, std::span<const float> rest, int height, int width,
                             std::span<const float> mean, std::span<const float> deviation)
    : normalization_(normalization),
      height_(height),
      width_(width),
      rest_(rest.begin(), rest.end()),
      mean_(mean.begin(), mean.end()) {
  for (const float d : deviation) scale_.push_back(1 / d);
  Window window(height, width);
  for (int y = 0; y < height; ++y) {
    window.move_to(y, [&](int from, float* target) {
      for (int c = 0; c < 3; ++c) {
        const float* plane = rest_.data() + (c * height + from) * width;
        std::copy(plane, plane + width, target + c * (width + 2) + 1);
      }
    });
    for (int x = 0; x < width; ++x) {
      const Steps r = steps_at(window.row(-1), window.row(0), window.row(1), x);
      length_u_.push_back(1 / dot(r.u, r.u));
      length_v_.push_back(1 / dot(r.v, r.v));
    }
  }
}

void LocalFeatures::positions(const Planes& image, int y, float* target) const {
  for (int c = 0; c < 3; ++c) {
    const auto i = static_cast<std::size_t>(c);
    const float low = normalization_.minimum[i], range = normalization_.maximum[i] - low;
    const float* source = image.row(c, y);
    const float* rest = rest_.data() + (c * height_ + y) * width_;
    float* row = target + c * (width_ + 2) + 1;
    for (int x = 0; x < width_; ++x) row[x] = source[x] * range + low + rest[x];
  }
}

void LocalFeatures::compute(const Planes& image, int begin, int end, float* features, int row, int stride,
                            float* axes) const {
  Window window(height_, width_);
  const int plane = height_ * width_;
  const auto physical = [&](int channel, int y, int x) {
    const auto c = static_cast<std::size_t>(channel);
    const float low = normalization_.minimum[c];
    return image.row(channel, y)[x] * (normalization_.maximum[c] - low) + low;
  };
  for (int y = begin; y < end; ++y) {
    window.move_to(y, [&](int from, float* target) { positions(image, from, target); });
    const Row above = window.row(-1), here = window.row(0), below = window.row(1);
    for (int x = 0; x < width_; ++x) {
      const int texel = y * width_ + x;
      const auto i = static_cast<std::size_t>(texel);
      const Steps s = steps_at(above, here, below, x);
      const Vector normal = unit(cross(s.u, s.v)), first = unit(s.u), second = cross(normal, first);
      const Vector n{physical(3, y, x), physical(4, y, x), physical(5, y, x)};
      const Vector v{physical(6, y, x), physical(7, y, x), physical(8, y, x)};
      const float values[kLocalChannels] = {dot(s.u, s.u) * length_u_[i] - 1,
                                            dot(s.v, s.v) * length_v_[i] - 1,
                                            dot(s.u, s.v) * std::sqrt(length_u_[i] * length_v_[i]),
                                            dot(s.uu, first),
                                            dot(s.uu, second),
                                            dot(s.uu, normal),
                                            dot(s.uv, first),
                                            dot(s.uv, second),
                                            dot(s.uv, normal),
                                            dot(s.vv, first),
                                            dot(s.vv, second),
                                            dot(s.vv, normal),
                                            dot(n, first),
                                            dot(n, second),
                                            dot(v, first),
                                            dot(v, second),
                                            dot(v, normal)};
      float* target = features + (static_cast<std::ptrdiff_t>(y + 1) * row + x + 1) * stride;
      for (std::size_t k = 0; k < kLocalChannels; ++k) {
        target[k] = std::clamp((values[k] - mean_[k]) * scale_[k], -kLargestFeature, kLargestFeature);
      }
      const float turned[9] = {first.x, first.y, first.z, second.x, second.y, second.z, normal.x, normal.y, normal.z};
      for (int k = 0; k < 9; ++k) axes[k * plane + texel] = turned[k];
    }
  }
}

void upsample_block(const float* plane, int height, int width, int y, int x, Block& block) {
  // Weights of the texel before, the texel and the one after for the four fine texels.
  static constexpr float kBefore[4] = {0.375F, 0.125F, 0, 0}, kHere[4] = {0.625F, 0.875F, 0.875F, 0.625F},
                         kAfter[4] = {0, 0, 0.125F, 0.375F};
  const int left = std::max(x - 1, 0), right = std::min(x + 1, width - 1);
  float rows[3][4];
  for (int k = 0; k < 3; ++k) {
    const float* row = plane + std::clamp(y + k - 1, 0, height - 1) * width;
    for (int i = 0; i < 4; ++i) rows[k][i] = kBefore[i] * row[left] + kHere[i] * row[x] + kAfter[i] * row[right];
  }
  for (std::size_t j = 0; j < 4; ++j) {
    for (std::size_t i = 0; i < 4; ++i) {
      block[4 * j + i] = kBefore[j] * rows[0][i] + kHere[j] * rows[1][i] + kAfter[j] * rows[2][i];
    }
  }
}

UpsampledMesh::UpsampledMesh(std::span<const std::int64_t> texels, std::span<const float> weights, std::size_t vertices,
                             std::span<const std::int64_t> corners, std::span<const float> corner_weights, int height,
                             int width)
    : vertices_(vertices) {
  const std::size_t count = texels.size() / vertices;
  rows_.push_back(0);
  for (std::size_t v = 0; v < vertices; ++v) {
    for (std::size_t k = v * count; k < (v + 1) * count; ++k) {
      if (weights[k] != 0) entries_.push_back({static_cast<std::int32_t>(texels[k]), weights[k]});
    }
    rows_.push_back(static_cast<std::uint32_t>(entries_.size()));
  }
  const auto h = static_cast<std::size_t>(height), w = static_cast<std::size_t>(width), fine = 16 * h * w;
  blocks_.push_back(0);
  for (std::size_t y = 0; y < h; ++y) {
    for (std::size_t x = 0; x < w; ++x) {
      const std::size_t begin = block_vertices_.size();
      for (std::size_t i = 0; i < 16; ++i) {
        const std::size_t texel = (4 * y + i / 4) * 4 * w + 4 * x + i % 4;
        for (std::size_t k = 0; k < 3; ++k) {
          const float weight = corner_weights[k * fine + texel];
          if (weight == 0) continue;
          const auto vertex = static_cast<std::uint32_t>(corners[k * fine + texel]);
          const auto first = block_vertices_.begin() + static_cast<std::ptrdiff_t>(begin);
          const auto found = std::find(first, block_vertices_.end(), vertex);
          const auto at = static_cast<std::size_t>(found - block_vertices_.begin());
          if (found == block_vertices_.end()) {
            block_vertices_.push_back(vertex);
            block_weights_.emplace_back().fill(0);
          }
          block_weights_[at][i] += weight;
        }
      }
      blocks_.push_back(static_cast<std::uint32_t>(block_vertices_.size()));
    }
  }
}

UpsampledMesh::UpsampledMesh(const MeshBase& base, int height, int width)
    : UpsampledMesh(base.vertex_texels, base.vertex_weights, static_cast<std::size_t>(base.vertices), base.corners,
                    base.weights, height, width) {}

void UpsampledMesh::image(const Planes& image, float* target) const {
  std::vector<float> values(vertices_ * kChannels);
  vertex_values(image, kChannels, 0, vertices_, values.data());
  const std::ptrdiff_t row = std::ptrdiff_t{kScale} * image.width, plane = row * kScale * image.height;
  Block block;
  for (int c = 0; c < kChannels; ++c) {
    for (int y = 0; y < image.height; ++y) {
      for (int x = 0; x < image.width; ++x) {
        block.fill(0.5F);
        add(values.data(), kChannels, c, static_cast<std::size_t>(y * image.width + x), block);
        float* place = target + c * plane + kScale * y * row + kScale * x;
        for (int i = 0; i < kScale; ++i) std::copy_n(block.data() + kScale * i, kScale, place + i * row);
      }
    }
  }
}

void UpsampledMesh::vertex_values(const Planes& image, int channels, std::size_t begin, std::size_t end,
                                  float* values) const {
  const std::ptrdiff_t plane = static_cast<std::ptrdiff_t>(image.height) * image.width;
  for (std::size_t v = begin; v < end; ++v) {
    float sums[kChannels] = {};
    for (std::uint32_t k = rows_[v]; k < rows_[v + 1]; ++k) {
      const Entry entry = entries_[k];
      for (int c = 0; c < channels; ++c) sums[c] += entry.weight * (image.data[c * plane + entry.texel] - 0.5F);
    }
    std::copy(sums, sums + channels, values + v * static_cast<std::size_t>(channels));
  }
}

void UpsampledMesh::add(const float* values, int channels, int channel, std::size_t texel, Block& block) const {
  for (std::uint32_t k = blocks_[texel]; k < blocks_[texel + 1]; ++k) {
    const float value =
        values[block_vertices_[k] * static_cast<std::uint32_t>(channels) + static_cast<std::uint32_t>(channel)];
    const Block& weights = block_weights_[k];
    for (std::size_t i = 0; i < block.size(); ++i) block[i] += value * weights[i];
  }
}

}  // namespace pleat::superres::cpu
