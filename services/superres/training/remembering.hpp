// Training of networks that remember (Description::memory) and of those with autoencoders (Description::twins).
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <cstddef>
#include <functional>

#include "services/superres/networks/network.hpp"
#include "services/superres/training/adam.hpp"
#include "services/superres/training/config.hpp"
#include "services/superres/training/sampler.hpp"

namespace pleat::superres {

class Remembering {
 public:
  /// All must outlive it. body: as Network::forward has it.
  Remembering(const TrainConfig& config, const Network& network, const Sampler& sampler, torch::ScalarType body)
      : config_(config), network_(network), sampler_(sampler), body_(body) {}

  /// Whether an epoch, counted from 0, trains the autoencoders alone.
  bool in_autoencoders(int epoch) const;

  /// Those of [tgl]: the sum of squared errors of a frame, and codes that grow too large.
  torch::Tensor autoencoder_loss(const Batch& batch) const;

  /// After their epochs the autoencoders stay as they are, at the running mean of their weights. Does nothing before.
  void hold_autoencoders(int epoch, const Adam& adam) const;

  /// Answers to a batch (B F images) that begins with window `first_window` of a step, from true answers with noise, or
  /// from its own. codes: mean squared difference between what it remembers and what the true answers would leave.
  torch::Tensor answers(const Batch& batch, int epoch, int step, int first_window, torch::Tensor& codes) const;

 private:
  /// What the network remembers before the windows of a batch, from what was before the frames that lead to them.
  torch::Tensor after_lead(const Batch& batch, torch::Tensor memory) const;
  const Description& description() const { return network_.description(); }

  const TrainConfig& config_;
  const Network& network_;
  const Sampler& sampler_;
  torch::ScalarType body_;
};

/// Answers of a network that remembers to `frames` consecutive frames of a sequence from its beginning, each from what
/// the one before left. input(frame): (1, inputs, h, w); use(answer, frame).
void run_on_own_answers(const Network& network, std::size_t frames, torch::ScalarType body,
                        const std::function<torch::Tensor(std::size_t)>& input,
                        const std::function<void(const torch::Tensor&, std::size_t)>& use);

}  // namespace pleat::superres
