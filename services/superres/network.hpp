// The networks of the registry as values: named parameters, a differentiable forward pass and its TorchScript twin.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "services/superres/cpu/trainable.hpp"
#include "services/superres/mesh_base.hpp"
#include "services/superres/metadata.hpp"

namespace torch::jit {
struct Module;
}

namespace pleat::superres {

/// Constants of a conditioned network, measured on the training split, per channel (nine each).
struct Conditioning {
  std::vector<float> input_mean, input_deviation;  ///< of the coarse images
  std::vector<float> detail_deviation;             ///< of the coarse images minus their 7x7 mean
  std::vector<float> output_deviation;             ///< of the fine images minus the residual's base
  std::vector<float> local_mean, local_deviation;  ///< axes "local": of the 17 features
  std::vector<float> local_output;                 ///< axes "local": of the residual in local axes, m, - and m/s (nine)
};

/// [MFSR] section 5.1, figure 4; blocks as in RDN (its reference [17]):
///   s0 = conv3(x), f0 = conv3(s0); block d: dense conv3 + ReLU layers, conv1 fusion, + its input;
///   g = conv3(conv1(concat of all blocks)) + s0; upsampling; one conv3 for each of displacement, normal, velocity.
/// Upsampling is bilinear with align_corners = false, which fits texel centres at (i + 0.5) / size.
/// Kind "srresnet": a block is f + conv3(relu(conv3(f))), and g = conv3(f) + s0 (SRResNet as its successor EDSR left
/// it, without normalisation by batches). Kind "chen2018": the same body on positions in place of the nine channels,
/// two sub-pixel stages of factor two and one convolution to positions; normals and velocities are interpolated.
class Network {
 public:
  /// Fresh weights from `seed`: uniform in +-1/sqrt(fan in), the same values on every machine. With a residual the
  /// heads begin at zero, so that an untrained network is that interpolation. Throws kInvalidArgument through
  /// validate(architecture).
  Network(const Architecture& architecture, std::uint64_t seed);

  /// Sets the constants of a network that needs_mesh(), for coarse images of height x width texels. No effect on
  /// others. Throws kInternal if the sizes contradict each other.
  void set_mesh_base(const MeshBase& base, const Normalization& normalization, int height, int width);

  /// Sets the constants of a conditioned network; no effect on others. Throws kInvalidArgument unless nine finite
  /// values each, deviations > 0.
  void set_conditioning(const Conditioning& conditioning);

  /// x: (N, 9, h, w) normalised float32. Returns (N, 9, 4h, 4w) float32. Differentiable. `body` is the type of all
  /// convolutions but the shallow ones: torch::kBFloat16 halves the time on processors and GPUs that have it.
  torch::Tensor forward(const torch::Tensor& x, torch::ScalarType body = torch::kFloat32) const;

  /// The same for patches of images with residual "mesh": their parts of base_image() and of the mesh's structure.
  torch::Tensor forward(const torch::Tensor& x, const torch::Tensor& base, const torch::Tensor& structure,
                        torch::ScalarType body) const;

  /// x: (N, C, h, w) of the whole image. Returns (N, C, 4h, 4w): the barycentrically upsampled mesh. Needs the mesh's
  /// constants.
  torch::Tensor base_image(const torch::Tensor& x) const;

  /// Forward passes on the processor, and their gradients, by our own kernels from now on (services/superres/cpu),
  /// where they know the architecture: a forward pass that needs gradients must be followed by its backward pass before
  /// the next one. threads: images at a time.
  void use_own_kernels(int threads);

  /// Parameters by name, in a fixed order; weights (out, in, k, k) and biases (out).
  const std::vector<std::pair<std::string, torch::Tensor>>& parameters() const { return parameters_; }
  /// Constants by name, not trained.
  const std::vector<std::pair<std::string, torch::Tensor>>& buffers() const { return buffers_; }
  std::vector<torch::Tensor> parameter_values() const;
  std::int64_t parameter_count() const;
  const Architecture& architecture() const { return architecture_; }
  void to(torch::Device device);

  /// Of the own kernels, for the autograd function in network.cpp alone.
  cpu::Trainable* trainable() const { return trainable_.get(); }

  /// The same function as a TorchScript module with one method `forward`, made of plain operators only. Its values are
  /// copies. The three heads become one convolution of nine outputs. Every parameter may be turned into bfloat16 except
  /// those named by float32_parameters(); input and output stay float32.
  torch::jit::Module to_script() const;
  static std::vector<std::string> float32_parameters();

 private:
  const torch::Tensor& get(const std::string& name) const;
  torch::Tensor body_forward(const torch::Tensor& x, const torch::Tensor& structure, torch::ScalarType body) const;
  torch::Tensor convolve(const torch::Tensor& x, const std::string& name, int kernel) const;
  torch::Tensor convolutions(const torch::Tensor& input, torch::ScalarType body) const;
  torch::Tensor own_convolutions(const torch::Tensor& input, torch::ScalarType body) const;
  torch::Tensor chen_forward(const torch::Tensor& x, torch::ScalarType body) const;
  torch::Tensor residual_blocks(torch::Tensor features) const;
  torch::Tensor prelu(const torch::Tensor& x, const std::string& name) const;
  void add_convolution(const std::string& name, int in, int out, int kernel, bool zero);
  void add_slope(const std::string& name);
  void add_residual_blocks();
  std::string script_source() const;
  std::string chen_script() const;

  Architecture architecture_;
  std::uint64_t random_state_;
  std::vector<std::pair<std::string, torch::Tensor>> parameters_;
  std::vector<std::pair<std::string, torch::Tensor>> buffers_;
  int own_threads_ = 0;  ///< 0: LibTorch's convolutions
  mutable std::shared_ptr<cpu::Trainable> trainable_;
};

/// The cloth's own axes at each coarse texel, and what is seen in them.
struct LocalFrame {
  torch::Tensor axes;      ///< (N, 9, h, w): unit vectors along u, across it in the sheet, and normal
  torch::Tensor features;  ///< (N, 17, h, w): strain (3), second differences (9), normal (2), velocity (3)
};

/// x: (N, 9, h, w) normalised; minimum, range: (1, 9, 1, 1); rest: (1, 3, h, w) metres.
LocalFrame local_frame(const torch::Tensor& x, const torch::Tensor& minimum, const torch::Tensor& range,
                       const torch::Tensor& rest);

/// Vectors in axes of the cloth -> in axes of the alignment. y: (N, 9, H, W), three vectors a texel; axes: (N, 9, H,
/// W).
torch::Tensor from_local(const torch::Tensor& y, const torch::Tensor& axes);
/// The inverse, for orthonormal axes.
torch::Tensor to_local(const torch::Tensor& y, const torch::Tensor& axes);

/// Bilinear upsampling by four with the texel-centre convention. x: (N, C, h, w); returns (N, C, 4h, 4w).
torch::Tensor upsample_bilinear(const torch::Tensor& x);

/// x minus the mean over its 7x7 neighbourhood (inside the image only): the local detail. Same shape.
torch::Tensor local_detail(const torch::Tensor& x);

}  // namespace pleat::superres
