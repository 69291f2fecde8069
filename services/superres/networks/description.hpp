// A network as a list of layers. This one description drives the forward pass with LibTorch, the processor's own
// kernels in both directions, and the TorchScript module that a bundle holds.
#pragma once

#include <string>
#include <vector>

namespace pleat::superres {

enum class LayerKind {
  kConvolution,   ///< kernel 3 or 1, stride 1, zero padding; one bias a channel
  kPixelShuffle,  ///< (factor^2 C, h, w) -> (C, factor h, factor w), LibTorch's order of channels
  kUpsample,      ///< bilinear, factor times the size; texel centres at (i + 0.5) / size
  kPool,          ///< mean over blocks of factor x factor, the last ones cut off by the border; ceil(h / factor) high
  kResize,        ///< bilinear to the size of value `like`; texel centres at (i + 0.5) / size
  kNorm,          ///< over the channels of a place: mean 0, deviation 1, then times NAME_weight plus NAME_bias
  kAttention,     ///< (3 C, h, w) -> (C, h, w): queries, keys and values, C of each, in `heads` parts; every place (or
               ///< every frame of a place) gets the values of all, weighted by softmax(query . key / sqrt(C / heads))
};

enum class Activation {
  kNone,
  kRelu,
  kPrelu,  ///< with a trained slope a channel, in the beginning 0.25
};

/// Values are numbered: 0 is the network's input, layer i makes value i + 1, and the last one is the answer.
struct Layer {
  LayerKind kind = LayerKind::kConvolution;
  std::string name = {};  ///< of its parameters: NAME_weight (out, in, k, k), NAME_bias (out), NAME_slope (out)
  std::vector<int> inputs =
      {};            ///< values of one size whose channels follow each other; one value but for convolutions
  int channels = 0;  ///< of its output
  int kernel = 3;
  int add = -1;  ///< value that is added before the activation (after a norm), or -1
  Activation activation = Activation::kNone;
  bool exact = false;  ///< always float32: layers that read metres in which wrinkles are millimetres
  bool zero = false;   ///< weights begin at zero, so that an untrained network answers with zeros
  int factor = 1;
  int like = -1;
  /// The channels are so many parts, of a frame each, on which the layer works alike: convolutions with kernel 1 and
  /// one input, norms, and attention.
  int frames = 1;
  int heads = 1;
  bool over_frames = false;  ///< attention between the frames of a place, instead of between the places of a frame
};

struct Size {
  int height = 0, width = 0;
  bool operator==(const Size&) const = default;
};

struct Description {
  explicit Description(int input_channels) : inputs(input_channels) {}

  /// Appends a layer and returns the number of its value. Channels of layers that are no convolution follow from their
  /// input. Throws kInternal for layers that contradict each other.
  int add(Layer layer);

  int values() const { return static_cast<int>(layers.size()) + 1; }
  int channels(int value) const;
  int input_channels(const Layer& layer) const;
  int outputs() const { return channels(values() - 1); }
  /// Of every value, for an input of this size.
  std::vector<Size> sizes(Size input) const;

  int inputs;
  std::vector<Layer> layers;
};

}  // namespace pleat::superres
