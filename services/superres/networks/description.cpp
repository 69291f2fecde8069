#include "services/superres/networks/description.hpp"

#include <algorithm>

#include "common/base/error.hpp"

namespace pleat::superres {

int Description::channels(int value) const {
  return value == 0 ? inputs : layers[static_cast<std::size_t>(value) - 1].channels;
}

int Description::input_channels(const Layer& layer) const {
  int count = 0;
  for (const int value : layer.inputs) count += channels(value);
  return count;
}

int Description::add(Layer layer) {
  const int next = values();
  const auto known = [&](int value) { return value >= 0 && value < next; };
  const bool convolution = layer.kind == LayerKind::kConvolution, norm = layer.kind == LayerKind::kNorm;
  const bool attention = layer.kind == LayerKind::kAttention;
  bool good = !layer.inputs.empty() && std::all_of(layer.inputs.begin(), layer.inputs.end(), known);
  if (good && !convolution) {
    const int parts = layer.kind == LayerKind::kPixelShuffle ? layer.factor * layer.factor : attention ? 3 : 1;
    layer.channels = channels(layer.inputs[0]) / parts;
    good = layer.inputs.size() == 1 && layer.channels * parts == channels(layer.inputs[0]) &&
           (layer.add < 0 || (norm && known(layer.add) && channels(layer.add) == layer.channels)) &&
           layer.activation == Activation::kNone && layer.factor >= 1 &&
           (layer.kind != LayerKind::kResize || known(layer.like)) && (!norm || !layer.name.empty()) &&
           (!attention || (layer.heads > 0 && layer.channels % (layer.frames * layer.heads) == 0));
  }
  good = good && layer.frames >= 1 && layer.channels % layer.frames == 0;
  if (layer.frames > 1) {
    good = good && (norm || attention ||
                    (convolution && layer.kernel == 1 && layer.inputs.size() == 1 &&
                     channels(layer.inputs[0]) % layer.frames == 0 && layer.activation != Activation::kPrelu));
  }
  if (convolution) {
    good = good && layer.channels > 0 && (layer.kernel == 1 || layer.kernel == 3) && !layer.name.empty() &&
           (layer.add < 0 || (known(layer.add) && channels(layer.add) == layer.channels));
  }
  if (!good) throw_internal("network: layer " + std::to_string(next) + " '" + layer.name + "' makes no sense");
  layers.push_back(std::move(layer));
  return next;
}

std::vector<Size> Description::sizes(Size input) const {
  std::vector<Size> result{input};
  for (const Layer& layer : layers) {
    Size size = result[static_cast<std::size_t>(layer.inputs[0])];
    const int f = layer.factor;
    if (layer.kind == LayerKind::kPixelShuffle || layer.kind == LayerKind::kUpsample) {
      size = {size.height * f, size.width * f};
    } else if (layer.kind == LayerKind::kPool) {
      size = {(size.height + f - 1) / f, (size.width + f - 1) / f};
    } else if (layer.kind == LayerKind::kResize) {
      size = result[static_cast<std::size_t>(layer.like)];
    }
    for (const int value : layer.inputs) {
      if (layer.kind == LayerKind::kConvolution && result[static_cast<std::size_t>(value)] != size) {
        throw_internal("network: layer '" + layer.name + "' reads values of several sizes");
      }
    }
    result.push_back(size);
  }
  return result;
}

}  // namespace pleat::superres
