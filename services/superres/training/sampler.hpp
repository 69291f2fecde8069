// Which windows a step sees. A pure function of (seed, epoch, step), so that a resumed training goes on exactly.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "services/superres/cpu/texels.hpp"
#include "services/superres/training/losses.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

class Sampler {
 public:
  /// Throws kInvalidArgument if no training sequence is as long as a window, or mirror is asked for and the rest mesh
  /// is not flat.
  Sampler(const TrainConfig& config, const PairData& data);

  int steps_per_epoch() const { return steps_; }
  int frames_per_window() const { return frames_; }

  /// The batch of a step; windows are drawn without repetition until all had their turn.
  Batch batch(int epoch, int step) const;

  /// The windows of a step, "sequence name:first frame, ...", for error messages.
  std::string describe(int epoch, int step) const;

 private:
  struct Window {
    std::size_t sequence, first;
  };
  std::vector<Window> windows_of(int epoch, int step) const;

  const TrainConfig& config_;
  const PairData& data_;
  int frames_, patch_height_, patch_width_, steps_;
  std::vector<Window> windows_;
  torch::Tensor structure_;  ///< (1, 2, H, W)
  std::shared_ptr<const cpu::UpsampledMesh> mesh_;
};

}  // namespace pleat::superres
