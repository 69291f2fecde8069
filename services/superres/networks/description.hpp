// A network as a list of layers. This one description drives the forward pass with LibTorch, the processor's own
// kernels in both directions, and the TorchScript module that a bundle holds.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace pleat::superres {

/// Each place of an output is the mean of some places of an input, or 0: places[offsets[p]] up to
/// places[offsets[p + 1]] for place p.
struct PlaceMap {
  std::int64_t columns = 0;  ///< places of the input
  std::vector<std::int64_t> offsets{0}, places;

  /// Appends a place of the output.
  void add(const std::vector<std::int64_t>& from) {
    places.insert(places.end(), from.begin(), from.end());
    offsets.push_back(static_cast<std::int64_t>(places.size()));
  }
  std::int64_t rows() const { return static_cast<std::int64_t>(offsets.size()) - 1; }
};

enum class LayerKind {
  kConvolution,   ///< kernel 3 or 1, stride 1, zero padding; one bias a channel
  kPixelShuffle,  ///< (factor^2 C, h, w) -> (C, factor h, factor w), LibTorch's order of channels
  kUpsample,      ///< bilinear, factor times the size; texel centres at (i + 0.5) / size
  kPool,          ///< mean over blocks of factor x factor, the last ones cut off by the border; ceil(h / factor) high
  kResize,        ///< bilinear to the size of value `like`; texel centres at (i + 0.5) / size
  kNorm,          ///< over the channels of a place: mean 0, deviation 1, then times NAME_weight plus NAME_bias
  kAttention,     ///< (3 C, h, w) -> (C, h, w): queries, keys and values, C of each, in `heads` parts; every place (or
               ///< every frame of a place) gets the values of all, weighted by softmax(query . key / sqrt(C / heads)).
               ///< Of two inputs the first one has the queries (C), the second one keys and values (2 C)
  kUnshuffle,  ///< the inverse of kPixelShuffle
  kSpread,     ///< (frames parts c, h, w) -> (frames C, 1, parts h w): what lay in the channels as parts lies side by
               ///< side, the first C of the c channels of each; further channels of the input are left out
  kMean,       ///< `map` between the places of its input and of its output, which is (C,) + size
  kReshape,    ///< the same numbers in the same order as (channels,) + size
  kPart,       ///< channels [first, first + channels)
  kJoin,       ///< the channels of all inputs, one after the other
  kTokens,     ///< (frames n, 1, 1) -> (frames C, 1, n): number k of a frame becomes a token at place k: itself times
               ///< NAME_weight[:, k], plus NAME_bias[:, k], plus the frame's NAME_time
  kMemory,     ///< what the network remembers, no input's value: the last `remembered` frames' memory(), oldest first;
               ///< zeros for frames that it did not see. As large as `size`, or as the input if that is none
  kGiven,      ///< in training a true answer: (channels, factor h, factor w)
};

enum class Activation {
  kNone,
  kRelu,
  kPrelu,  ///< with a trained slope a channel, in the beginning 0.25
  kTanh,
  kLeakyRelu,  ///< 0.02 x for x < 0
};

struct Size {
  int height = 0, width = 0;
  bool operator==(const Size&) const = default;
};

/// Values are numbered: 0 is the network's input, layer i makes value i + 1, and the last one is the answer.
struct Layer {
  LayerKind kind = LayerKind::kConvolution;
  /// Of its parameters: NAME_weight (out, in, k, k), NAME_bias (out), NAME_slope (out). Layers of one name share them.
  std::string name = {};
  /// Values of one size whose channels follow each other; one value but for convolutions, attention and kJoin.
  std::vector<int> inputs = {};
  int channels = 0;  ///< of its output
  int kernel = 3;
  int add = -1;  ///< value that is added before the activation (after a norm), or -1
  Activation activation = Activation::kNone;
  bool exact = false;  ///< always float32: layers that read metres in which wrinkles are millimetres
  bool zero = false;   ///< weights begin at zero, so that an untrained network answers with zeros
  int factor = 1;
  int like = -1;
  /// The channels are so many parts, of a frame each, on which the layer works alike: convolutions with kernel 1,
  /// norms, attention, and what names them above.
  int frames = 1;
  int heads = 1;
  bool over_frames = false;  ///< attention between the frames of a place, instead of between the places of a frame
  bool causal = false;       ///< attention between frames: only to itself and older ones
  /// Of a convolution with kernel 1: its weights are those of this layer transposed, each input's by itself.
  std::string tied = {};
  int first = 0;                             ///< of kPart
  int parts = 1, each = 0;                   ///< of kSpread: parts, and c
  Size size = {};                            ///< of kMean, kReshape, kMemory
  std::shared_ptr<const PlaceMap> map = {};  ///< of kMean
};

/// Convolutions, resizing and shuffles, on all channels alike: what networks of images are made of.
bool is_image_layer(const Layer& layer);

/// What is remembered is cut to +-this: input that no training saw must not let it grow from frame to frame.
inline constexpr double kMemoryLimit = 32;

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

  bool remembers() const { return memory >= 0; }
  /// (channels, height, width) of all that the network remembers, for an input of this size.
  std::array<int, 3> memory_shape(Size input) const;
  /// Which layers these values depend on: by layers.
  std::vector<bool> needed(const std::vector<int>& wanted) const;

  int inputs;
  std::vector<Layer> layers;
  int memory = -1;        ///< value that is remembered of a frame; -1: none
  int given_memory = -1;  ///< what would be remembered of a frame whose answer is the given one
  int remembered = 0;     ///< frames
  /// Of autoencoders: what came out, what it should be, and the code between them.
  struct Twin {
    int out = -1, in = -1, code = -1;
  };
  std::vector<Twin> twins = {};
  bool ends_only = false;  ///< a stand-in for a network whose meshes are not known: its ends are right, nothing else
  int reconstructed = -1;  ///< the given answer after its autoencoder, as an answer
};

}  // namespace pleat::superres
