#include "services/superres/kernels/resample.hpp"

#include <algorithm>
#include <utility>

namespace pleat::superres::kernels {
namespace {

/// Two texels and the weight of the second: texel centres at (i + 0.5) / size.
struct Mix {
  int low, high;
  float t;
  Mix(int i, int to, int from) {
    const float scale = static_cast<float>(from) / static_cast<float>(to);
    const float position = std::max(0.0F, (static_cast<float>(i) + 0.5F) * scale - 0.5F);
    low = std::min(static_cast<int>(position), from - 1);
    high = std::min(low + 1, from - 1);
    t = position - static_cast<float>(low);
  }
};

/// Calls use(pixel of the input, its first channel, channels of it a channel of the output, weight).
template <typename Use>
void for_sources(const Layer& layer, const Geometry& from, const Geometry& to, int y, int x, const Use& use) {
  const int f = layer.factor;
  if (layer.kind == LayerKind::kPixelShuffle) {
    use(from.pixel(y / f, x / f), y % f * f + x % f, f * f, 1.0F);
  } else if (layer.kind == LayerKind::kPool) {
    const int bottom = std::min((y + 1) * f, from.height), right = std::min((x + 1) * f, from.width);
    const float weight = 1 / static_cast<float>((bottom - y * f) * (right - x * f));
    for (int i = y * f; i < bottom; ++i) {
      for (int j = x * f; j < right; ++j) use(from.pixel(i, j), 0, 1, weight);
    }
  } else {
    const Mix v(y, to.height, from.height), u(x, to.width, from.width);
    use(from.pixel(v.low, u.low), 0, 1, (1 - v.t) * (1 - u.t));
    use(from.pixel(v.low, u.high), 0, 1, (1 - v.t) * u.t);
    use(from.pixel(v.high, u.low), 0, 1, v.t * (1 - u.t));
    use(from.pixel(v.high, u.high), 0, 1, v.t * u.t);
  }
}

}  // namespace

void resample_pixel(const Layer& layer, const Geometry& from, const Geometry& to, const float* source, int stride,
                    int channels, int y, int x, float* target) {
  std::fill_n(target, channels, 0.0F);
  for_sources(layer, from, to, y, x, [&](std::size_t pixel, int first, int step, float weight) {
    const float* values = source + pixel * static_cast<std::size_t>(stride) + first;
    if (step == 1) {
      for (int c = 0; c < channels; ++c) target[c] += weight * values[c];
    } else {
      for (int c = 0; c < channels; ++c) target[c] += weight * values[c * step];
    }
  });
}

void resample_gradient(const Layer& layer, const Geometry& from, const Geometry& to, float* source, int stride,
                       int channels, int y, int x, const float* target) {
  for_sources(layer, from, to, y, x, [&](std::size_t pixel, int first, int step, float weight) {
    float* values = source + pixel * static_cast<std::size_t>(stride) + first;
    for (int c = 0; c < channels; ++c) values[c * step] += weight * target[c];
  });
}

}  // namespace pleat::superres::kernels
