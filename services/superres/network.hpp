// The [MFSR] network as a value: named parameters, a differentiable forward pass and its TorchScript twin.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <string>
#include <utility>
#include <vector>

#include "services/superres/metadata.hpp"

namespace torch::jit {
struct Module;
}

namespace pleat::superres {

/// Constants of a conditioned network, measured on the training split, per channel (nine each).
struct Conditioning {
  std::vector<float> input_mean, input_deviation;  ///< of the coarse images
  std::vector<float> detail_deviation;             ///< of the coarse images minus their 7x7 mean
  std::vector<float> output_deviation;             ///< of the fine images minus the upsampled coarse ones
};

/// [MFSR] section 5.1, figure 4; blocks as in RDN (its reference [17]):
///   s0 = conv3(x), f0 = conv3(s0); block d: dense conv3 + ReLU layers, conv1 fusion, + its input;
///   g = conv3(conv1(concat of all blocks)) + s0; upsampling; one conv3 for each of displacement, normal, velocity.
/// Upsampling is bilinear with align_corners = false, which fits texel centres at (i + 0.5) / size.
class Network {
 public:
  /// Fresh weights from `seed`: uniform in +-1/sqrt(fan in), the same values on every machine. With `residual` the
  /// heads begin at zero, so that an untrained network is the bilinear upsampling. Throws kInvalidArgument through
  /// validate(architecture).
  Network(const Architecture& architecture, std::uint64_t seed);

  /// Sets the constants of a conditioned network; no effect on others. Throws kInvalidArgument unless nine finite
  /// values each, deviations > 0.
  void set_conditioning(const Conditioning& conditioning);

  /// x: (N, 9, h, w) normalised float32. Returns (N, 9, 4h, 4w) float32. Differentiable. `body` is the type of all
  /// convolutions but the shallow ones: torch::kBFloat16 halves the time on processors and GPUs that have it.
  torch::Tensor forward(const torch::Tensor& x, torch::ScalarType body = torch::kFloat32) const;

  /// Parameters by name, in a fixed order; weights (out, in, k, k) and biases (out).
  const std::vector<std::pair<std::string, torch::Tensor>>& parameters() const { return parameters_; }
  /// Constants by name, not trained.
  const std::vector<std::pair<std::string, torch::Tensor>>& buffers() const { return buffers_; }
  std::vector<torch::Tensor> parameter_values() const;
  std::int64_t parameter_count() const;
  const Architecture& architecture() const { return architecture_; }
  void to(torch::Device device);

  /// The same function as a TorchScript module with one method `forward`, made of plain operators only. Its values are
  /// copies. The three heads become one convolution of nine outputs. Every parameter may be turned into bfloat16 except
  /// those named by float32_parameters(); input and output stay float32.
  torch::jit::Module to_script() const;
  static std::vector<std::string> float32_parameters();

 private:
  const torch::Tensor& get(const std::string& name) const;
  torch::Tensor convolve(const torch::Tensor& x, const std::string& name, int kernel) const;
  void add_convolution(const std::string& name, int in, int out, int kernel, bool zero);
  std::string script_source() const;

  Architecture architecture_;
  std::uint64_t random_state_;
  std::vector<std::pair<std::string, torch::Tensor>> parameters_;
  std::vector<std::pair<std::string, torch::Tensor>> buffers_;
};

/// Bilinear upsampling by four with the texel-centre convention. x: (N, C, h, w); returns (N, C, 4h, 4w).
torch::Tensor upsample_bilinear(const torch::Tensor& x);

/// x minus the mean over its 7x7 neighbourhood (inside the image only): the local detail. Same shape.
torch::Tensor local_detail(const torch::Tensor& x);

}  // namespace pleat::superres
