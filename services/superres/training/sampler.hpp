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

  int windows_per_step() const { return config_.batch; }

  /// Windows [first, last) of a step's batch. They are drawn without repetition until all had their turn.
  Batch batch(int epoch, int step, int first, int last) const;
  Batch batch(int epoch, int step) const { return batch(epoch, step, 0, config_.batch); }

  /// Valid texels of all images of a step.
  double valid_texels(int epoch, int step) const;

  /// The windows of a step, "sequence name:first frame, ...", for error messages.
  std::string describe(int epoch, int step) const;

 private:
  struct Window {
    std::size_t sequence, first;
  };
  /// Where a window is cut out, and how it is mirrored.
  struct Cut {
    int row, column;
    std::uint64_t mirror;
  };
  std::vector<Window> windows_of(int epoch, int step) const;
  Cut cut_of(int epoch, int step, int window) const;

  const TrainConfig& config_;
  const PairData& data_;
  int frames_, patch_height_, patch_width_, steps_;
  std::vector<Window> windows_;
  torch::Tensor structure_;  ///< (1, 2, H, W)
  /// For losses on vertices: what they read in an image reversed along u (bit 0) and v (bit 1), each (K V) int64, and
  /// the rest positions (3, V).
  std::vector<torch::Tensor> vertex_texels_;
  torch::Tensor vertex_rest_;
  std::shared_ptr<const cpu::UpsampledMesh> mesh_;
};

}  // namespace pleat::superres
