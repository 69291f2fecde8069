// One image through the convolutions of TrainableLayers, forwards and backwards. One thread each.
#pragma once

#include <vector>

#include "services/superres/cpu/trainable_layers.hpp"

namespace pleat::superres::cpu {

/// An image of features as Geometry says.
struct Features {
  Buffer buffer;
  int stride = 0;
  Features() = default;
  Features(const Geometry& g, int channels, int element)
      : buffer(g.pixels() * static_cast<std::size_t>(channels) * static_cast<std::size_t>(element)), stride(channels) {}

  /// Of float32: the channels of pixel p, from `first` on.
  float* floats(std::size_t p, int first = 0) const { return buffer.floats() + offset(p, first); }
  /// The same of elements of any size.
  void* at(std::size_t p, int first, int element) const { return buffer.at(offset(p, first), element); }

 private:
  std::size_t offset(std::size_t p, int first) const {
    return p * static_cast<std::size_t>(stride) + static_cast<std::size_t>(first);
  }
};

/// What the backward pass needs of one image.
struct Kept {
  explicit Kept(const TrainableLayers& net);

  Features input, shallow;          ///< float32
  std::vector<Features> stacks;     ///< elements: f and its layers; "srresnet": f and what is between the two layers
  Features hierarchy, fused, last;  ///< elements
};

/// Scratch of one thread, and its sums.
struct Worker {
  explicit Worker(const TrainableLayers& net);

  Features trunk, stack_gradient, hierarchy_gradient, shallow_gradient;  ///< float32
  Features small, layers, answer;                                        ///< elements
  Features answer32;
  Buffer tiles, input_groups, output_groups, sums, scratch;
  std::vector<Gradient> gradients;  ///< one a convolution
};

/// input: (inputs, h, w); output: (outputs, h, w).
void forward_image(const TrainableLayers& net, const float* input, Kept& kept, Worker& worker, float* output);

/// gradient: of forward_image()'s output. Adds to the worker's gradients.
void backward_image(const TrainableLayers& net, const float* gradient, const Kept& kept, Worker& worker);

}  // namespace pleat::superres::cpu
