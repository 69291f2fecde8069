#include "services/superres/training/losses.hpp"

namespace pleat::superres {
namespace {

using torch::indexing::Slice;

/// (B, F, 3, H, W) rotated by the inverse of (B, F, 3, 3).
torch::Tensor rotate_back(const torch::Tensor& vectors, const torch::Tensor& rotations) {
  return torch::einsum("bfji,bfjhw->bfihw", {rotations, vectors});
}

torch::Tensor kinematic_loss(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                             const LossConfig& config) {
  const std::int64_t frames = batch.frames, windows = synthesized.size(0) / frames;
  const auto shape = [&](const torch::Tensor& t, int first) {
    const auto channels = Slice(first, first + 3);
    const auto minimum = constants.minimum.index({channels}).view({1, 3, 1, 1});
    const auto range = constants.range.index({channels}).view({1, 3, 1, 1});
    const auto part = t.index({Slice(), channels}) * range + minimum;
    return part.view({windows, frames, 3, t.size(2), t.size(3)});
  };
  const bool exact = config.alignment == "exact";
  torch::Tensor d = shape(synthesized, 0), v = shape(synthesized, 6);
  const torch::Tensor true_d = shape(batch.fine, 0), true_v = shape(batch.fine, 6);
  torch::Tensor target = config.target == "ground_truth" ? true_d : d;
  if (exact) {
    // The simulated frames satisfy the relation exactly, so the errors alone have to; the rest positions and
    // translations cancel, and only rotations remain.
    const auto rotations = batch.rotations.view({windows, frames, 3, 3});
    target = rotate_back(target - true_d, rotations);
    d = rotate_back(d - true_d, rotations);
    v = rotate_back(v - true_v, rotations);
  }
  // Frames of a window share the mask: (B, 1, 1, H, W), counted once for each k.
  const auto mask =
      batch.mask.view({windows, frames, 1, synthesized.size(2), synthesized.size(3)}).index({Slice(), Slice(0, 1)});
  const auto steps = torch::cumsum(v.index({Slice(), Slice(1)}), 1) * constants.frame_time_s;
  const auto residual = target.index({Slice(), Slice(1)}) - (d.index({Slice(), Slice(0, 1)}) + steps);
  auto lengths = constants.range.index({Slice(0, 3)});
  if (config.scaling == "deviation") lengths = lengths * constants.deviation.index({Slice(0, 3)});
  // Eq. 5 sums over k.
  return (residual / lengths.mean()).square().mul(mask).sum() / (mask.sum() * 3);
}

}  // namespace

Losses compute_losses(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                      const LossConfig& config) {
  auto error = (synthesized - batch.fine).square();
  if (config.scaling == "deviation") error = error / constants.deviation.square().view({1, 9, 1, 1});
  error = error * batch.mask;
  const auto texels = batch.mask.sum() * 3;
  const auto part = [&](int first) { return error.index({Slice(), Slice(first, first + 3)}).sum() / texels; };
  Losses losses;
  losses.displacement = part(0);
  losses.normal = part(3);
  losses.velocity = part(6);
  losses.total =
      config.displacement * losses.displacement + config.normal * losses.normal + config.velocity * losses.velocity;
  if (batch.frames > 1 && config.kinematic > 0) {
    losses.kinematic = kinematic_loss(synthesized, batch, constants, config);
    losses.total = losses.total + config.kinematic * losses.kinematic;
  } else {
    losses.kinematic = torch::zeros_like(losses.total);
  }
  return losses;
}

}  // namespace pleat::superres
