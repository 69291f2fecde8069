#include "services/superres/networks/description.hpp"

#include <algorithm>

#include "common/base/error.hpp"

namespace pleat::superres {

bool is_image_layer(const Layer& layer) {
  switch (layer.kind) {
    case LayerKind::kConvolution:
    case LayerKind::kPixelShuffle:
    case LayerKind::kUpsample:
    case LayerKind::kPool:
    case LayerKind::kResize:
      return layer.frames == 1 && layer.tied.empty() && layer.activation != Activation::kTanh &&
             layer.activation != Activation::kLeakyRelu;
    default:
      return false;
  }
}

int Description::channels(int value) const {
  return value == 0 ? inputs : layers[static_cast<std::size_t>(value) - 1].channels;
}

int Description::input_channels(const Layer& layer) const {
  int count = 0;
  for (const int value : layer.inputs) count += channels(value);
  return count;
}

namespace {

bool has_weights(const Layer& layer) { return layer.kind == LayerKind::kConvolution || layer.kind == LayerKind::kNorm; }

/// Of layers whose output's channels follow from their input's; 0 where they make no sense.
int channels_of(const Description& network, const Layer& layer) {
  const int in = network.channels(layer.inputs[0]), square = layer.factor * layer.factor;
  const auto share = [&](int parts) { return in % parts == 0 ? in / parts : 0; };
  switch (layer.kind) {
    case LayerKind::kPixelShuffle:
      return share(square);
    case LayerKind::kUnshuffle:
      return in * square;
    case LayerKind::kAttention:
      if (layer.inputs.size() == 1) return share(3);
      return layer.inputs.size() == 2 && network.channels(layer.inputs[1]) == 2 * in ? in : 0;
    case LayerKind::kJoin:
      return network.input_channels(layer);
    case LayerKind::kPart:
      return layer.first >= 0 && layer.first + layer.channels <= in ? layer.channels : 0;
    case LayerKind::kSpread:
      return layer.parts >= 1 && layer.channels <= layer.frames * layer.each &&
                     layer.frames * layer.parts * layer.each <= in
                 ? layer.channels
                 : 0;
    case LayerKind::kReshape:
    case LayerKind::kMemory:
    case LayerKind::kGiven:
    case LayerKind::kTokens:
    case LayerKind::kConvolution:
      return layer.channels;
    default:
      return in;
  }
}

}  // namespace

int Description::add(Layer layer) {
  const int next = values();
  const auto known = [&](int value) { return value >= 0 && value < next; };
  const bool convolution = layer.kind == LayerKind::kConvolution, norm = layer.kind == LayerKind::kNorm;
  const bool attention = layer.kind == LayerKind::kAttention, join = layer.kind == LayerKind::kJoin;
  bool good = !layer.inputs.empty() && std::all_of(layer.inputs.begin(), layer.inputs.end(), known) &&
              layer.frames >= 1 && layer.factor >= 1;
  if (good) {
    layer.channels = channels_of(*this, layer);
    const bool named = has_weights(layer) || layer.kind == LayerKind::kTokens || layer.kind == LayerKind::kMean;
    good = layer.channels > 0 && layer.channels % layer.frames == 0 &&
           (convolution || attention || join || layer.inputs.size() == 1) && (!named || !layer.name.empty()) &&
           (layer.add < 0 || (has_weights(layer) && known(layer.add) && channels(layer.add) == layer.channels)) &&
           (convolution || layer.activation == Activation::kNone) &&
           (layer.kind != LayerKind::kResize || known(layer.like)) &&
           (layer.kind != LayerKind::kMean ||
            (layer.map && layer.map->rows() == std::int64_t{layer.size.height} * layer.size.width)) &&
           (!attention || (layer.heads > 0 && layer.channels % (layer.frames * layer.heads) == 0));
  }
  if (good && layer.frames > 1) {
    good = norm || attention || layer.kind == LayerKind::kSpread || layer.kind == LayerKind::kTokens ||
           (convolution && layer.kernel == 1 && layer.activation != Activation::kPrelu);
    for (const int value : layer.inputs) {
      good = good && (layer.kind == LayerKind::kSpread || channels(value) % layer.frames == 0);
    }
  }
  if (convolution) {
    good = good && (layer.kernel == 1 || layer.kernel == 3) && (layer.tied.empty() || layer.kernel == 1);
  }
  if (!good) throw_internal("network: layer " + std::to_string(next) + " '" + layer.name + "' makes no sense");
  layers.push_back(std::move(layer));
  return next;
}

std::array<int, 3> Description::memory_shape(Size input) const {
  for (std::size_t i = 0; i < layers.size(); ++i) {
    if (layers[i].kind != LayerKind::kMemory) continue;
    const Size size = sizes(input)[i + 1];
    return {layers[i].channels, size.height, size.width};
  }
  return {};
}

std::vector<bool> Description::needed(const std::vector<int>& wanted) const {
  std::vector<bool> result(layers.size(), false);
  for (const int value : wanted) {
    if (value > 0) result[static_cast<std::size_t>(value) - 1] = true;
  }
  for (std::size_t i = layers.size(); i-- > 0;) {
    if (!result[i]) continue;
    const auto need = [&](int value) {
      if (value > 0) result[static_cast<std::size_t>(value) - 1] = true;
    };
    for (const int value : layers[i].inputs) need(value);
    need(layers[i].add);
    need(layers[i].like);
  }
  return result;
}

std::vector<Size> Description::sizes(Size input) const {
  std::vector<Size> result{input};
  for (const Layer& layer : layers) {
    Size size = result[static_cast<std::size_t>(layer.inputs[0])];
    const int f = layer.factor;
    if (layer.kind == LayerKind::kPixelShuffle || layer.kind == LayerKind::kUpsample ||
        layer.kind == LayerKind::kGiven) {
      size = {size.height * f, size.width * f};
    } else if (layer.kind == LayerKind::kUnshuffle) {
      size = {size.height / f, size.width / f};
    } else if (layer.kind == LayerKind::kSpread) {
      size = {1, layer.parts * size.height * size.width};
    } else if (layer.kind == LayerKind::kTokens) {
      size = {1, channels(layer.inputs[0]) / layer.frames};
    } else if (layer.size.height > 0) {
      size = layer.size;
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
