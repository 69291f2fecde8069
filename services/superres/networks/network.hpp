// A network of the registry as values: named parameters, a differentiable forward pass and its TorchScript twin.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "services/superres/kernels/trainable.hpp"
#include "services/superres/networks/description.hpp"

namespace torch::jit {
struct Module;
}

namespace pleat::superres {

class Network {
 public:
  /// Fresh weights from `seed`: uniform in +-1/sqrt(fan in), the same values on every machine; zero where the
  /// description says so.
  Network(const Description& description, std::uint64_t seed);

  /// x: (N, inputs, h, w) float32. Returns (N, outputs, H, W) float32. Differentiable. `body` is the type of all layers
  /// but the exact ones: torch::kBFloat16 halves the time on processors and GPUs that have it.
  torch::Tensor forward(const torch::Tensor& x, torch::ScalarType body = torch::kFloat32) const;

  /// What a network that remembers reads beside x: (N, R m, h', w'), what it remembers (no_memory() in the beginning),
  /// and in training the true answer, (N, outputs, H, W), where a value asks for it.
  struct Reads {
    torch::Tensor x, memory, given;
  };
  /// The named values of the description (Description::memory, twins, ...), each (N, C, h, w). Computes what they need
  /// and nothing else. Differentiable, by LibTorch's kernels.
  std::vector<torch::Tensor> values(const Reads& reads, const std::vector<int>& wanted,
                                    torch::ScalarType body = torch::kFloat32) const;
  /// Of x: (N, inputs, h, w).
  torch::Tensor no_memory(const torch::Tensor& x) const;
  /// What is remembered after a frame: `memory` without its oldest frame, and `newest` (N, m, h', w'), cut to
  /// +-kMemoryLimit.
  torch::Tensor remember(const torch::Tensor& memory, const torch::Tensor& newest) const;

  /// Forward passes on the processor, and their gradients, by our own kernels from now on (services/superres/kernels),
  /// where they know the layers: a forward pass that needs gradients must be followed by its backward pass before the
  /// next one. threads: images at a time; 0: LibTorch's kernels again.
  void use_own_kernels(int threads);

  /// Parameters by name, in a fixed order; weights (out, in, k, k), biases and slopes (out).
  const std::vector<std::pair<std::string, torch::Tensor>>& parameters() const { return parameters_; }
  std::vector<torch::Tensor> parameter_values() const;
  std::int64_t parameter_count() const;
  const Description& description() const { return description_; }
  void to(torch::Device device);

  /// Of the own kernels, for the autograd function in network.cpp alone.
  kernels::Trainable* trainable() const { return trainable_.get(); }

  /// The same function as a TorchScript module with one method `forward`, made of plain operators only: x to the
  /// answer, or (x, memory) to the answer and what is remembered after it. Its values are copies. Every parameter may
  /// be turned into bfloat16 except those named by float32_parameters(); input and output stay float32.
  torch::jit::Module to_script() const;
  /// The exact layers' names.
  std::vector<std::string> float32_parameters() const;
  /// The parameters of the layers that these values depend on, by their place in parameters().
  std::vector<std::size_t> parameters_of(const std::vector<int>& wanted) const;

 private:
  const torch::Tensor& get(const std::string& name) const;
  torch::Tensor layer_forward(const Layer& layer, const std::vector<torch::Tensor>& values, const Reads& reads,
                              torch::ScalarType body) const;
  torch::Tensor convolution(const Layer& layer, const std::vector<torch::Tensor>& values, torch::ScalarType body) const;
  torch::Tensor mean(const torch::Tensor& x, const Layer& layer) const;
  torch::Tensor own_forward(const torch::Tensor& x, bool bfloat16) const;

  Description description_;
  std::vector<std::pair<std::string, torch::Tensor>> parameters_;
  std::map<std::string, torch::Tensor> means_;  ///< of kMean layers by name: sparse (rows, places of the input)
  int own_threads_ = 0;                         ///< 0: LibTorch's kernels
  mutable std::shared_ptr<kernels::Trainable> trainable_;
};

/// Bilinear upsampling with texel centres at (i + 0.5) / size. x: (N, C, h, w); returns (N, C, factor h, factor w).
torch::Tensor upsample_bilinear(const torch::Tensor& x, int factor);

}  // namespace pleat::superres
