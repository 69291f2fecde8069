// Adam with bias correction and a running mean of the weights. Inside services/superres only: needs LibTorch.
#pragma once

#include <torch/torch.h>

#include <vector>

#include "services/superres/training/config.hpp"

namespace pleat::superres {

/// Its state is plain tensors, so that a check-point restores it exactly on every version of LibTorch.
struct Adam {
  Adam(std::vector<torch::Tensor> values, const OptimizerConfig& options);

  /// One step from the gradients of `parameters`, which are then cleared. Returns the gradient's norm before clipping.
  double step(double learning_rate);

  OptimizerConfig config;
  std::vector<torch::Tensor> parameters;
  std::vector<torch::Tensor> first, second;  ///< moments
  std::vector<torch::Tensor> average;        ///< running mean of the parameters; equal to them if config.average is 0
  std::int64_t steps = 0;
};

}  // namespace pleat::superres
