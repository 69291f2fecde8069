// The convolutions of a network that is trained: where their channels lie, their weights for both directions.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "services/superres/cpu/trainable.hpp"
#include "services/superres/cpu/weights.hpp"

namespace pleat::superres::cpu {

inline std::size_t times(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

/// A convolution and where its channels lie in padded images.
struct Convolution {
  std::vector<std::string> names;  ///< of the layers that make its outputs, side by side ("head_...": three)
  int kernel = 3;
  std::vector<int> places;  ///< of its input channels
  int inputs = 0;           ///< padded
  int outputs = 0, padded_outputs = 0;
  Buffer weights, bias;  ///< for the forward pass
  std::size_t taps() const { return static_cast<std::size_t>(kernel * kernel); }
  std::size_t size() const { return taps() * times(inputs, padded_outputs); }
};

/// Sums of one thread over its images.
struct Gradient {
  Buffer taps, bias;  ///< (taps, inputs, padded outputs), (padded outputs)
};

/// What all images and threads share.
struct TrainableLayers {
  using Find = std::function<Parameter(const std::string&)>;

  TrainableLayers(const Architecture& architecture, const TrainableOptions& options);

  int stack_channels() const { return features + (dense ? a.layers * growth : features); }
  int outputs() const { return subpixel ? kChannels * kScale * kScale : a.features; }

  /// Packs the parameters' values.
  void load(const Find& find);
  /// Adds sums over all images to the parameters' gradients. sums: one a convolution.
  void add_gradients(const std::vector<Gradient>& sums, const Find& find) const;

  Architecture a;
  TrainableOptions options;
  Geometry g;
  const Kernels* plain;          ///< of the shallow convolutions
  const Kernels* body;           ///< of all others
  int element;                   ///< of the body's
  int features, growth, inputs;  ///< padded
  bool dense, subpixel;

  std::vector<Convolution> convolutions;
  // Places in `convolutions`.
  std::size_t shallow0 = 0, shallow1 = 0, global0 = 0, global1 = 0, heads = 0;
  std::vector<std::vector<std::size_t>> layers;
  std::vector<std::size_t> fusions;

  // Weights of the gradients of inputs.
  Buffer back_shallow1, back_global0, back_global1, back_heads;
  std::vector<Buffer> back_fusions;
  std::vector<std::vector<Buffer>> back_layers;  ///< of a block: of f, then of each layer, from all later ones
  Buffer no_bias, zero_slope;

 private:
  std::size_t add(const Kernels& kernels, std::vector<std::string> names, int kernel, std::vector<int> places,
                  int padded_inputs, int output_count);
  Buffer back_buffer(int k, int n, bool one, const Kernels& kernels) const;
  void describe();
};

}  // namespace pleat::superres::cpu
