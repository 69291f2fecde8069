// Which windows a step sees. A pure function of (seed, epoch, step), so that a resumed training goes on exactly.
// Inside services/superres only: this header needs LibTorch.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "services/superres/training/losses.hpp"
#include "services/superres/training/mirror.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

class Sampler {
 public:
  /// Throws kInvalidArgument if no training sequence is as long as a window, mirror is asked for and can't be had, or
  /// losses on vertices are and the data know no vertices.
  /// remembered: frames of what the network remembers; then windows have config.history.frames frames.
  Sampler(const TrainConfig& config, const PairData& data, int remembered = 0);

  int steps_per_epoch() const { return steps_; }
  int frames_per_window() const { return frames_; }

  int windows_per_step() const { return config_.batch; }

  /// Windows [first, last) of a step's batch, which have to be of one mesh. They are drawn without repetition until all
  /// had their turn; those of a mesh come one after the other.
  Batch batch(int epoch, int step, int first, int last) const;
  Batch batch(int epoch, int step) const { return batch(epoch, step, 0, config_.batch); }

  /// Where passes over windows [first, last) of a step end: each is of one mesh, and of at most `most` windows.
  std::vector<int> passes(int epoch, int step, int first, int last, int most) const;

  /// The answers to a batch as if its inputs had not been mirrored: what belongs to batch.answer. Differentiable.
  torch::Tensor unmirrored(const torch::Tensor& answers, const Batch& batch) const;

  /// Valid texels of all images of a step.
  double valid_texels(int epoch, int step) const;

  /// Whether the frames of a step go on from the network's own answers.
  bool is_free(int epoch, int step) const;
  /// Numbers of mean 0 and deviation 1 as large as `like`, (B, ...), for windows [first, first + B) of a step.
  torch::Tensor noise(int epoch, int step, int first, const torch::Tensor& like) const;

  /// The windows of a step, "sequence name:first frame, ...", for error messages.
  std::string describe(int epoch, int step) const;

 private:
  struct Window {
    std::size_t sequence, first;
  };
  /// Where a window is cut out, and how it is mirrored.
  struct Cut {
    int row, column, height, width;
    std::uint64_t mirror;
  };
  std::vector<Window> windows_of(int epoch, int step) const;
  Cut cut_of(int epoch, int step, int index, const Window& window) const;
  void read_image(const PairSequence& sequence, std::size_t frame, const Cut& cut, Batch& batch, std::int64_t n) const;
  void read_input(const PairSequence& sequence, std::size_t frame, const Cut& cut, torch::Tensor input) const;
  void read_before(const Window& window, Batch& batch, std::int64_t n) const;
  /// The last of batch.lead: `frames` before a window.
  void read_lead(const Window& window, std::size_t frames, Batch& batch, std::int64_t n) const;
  void read_vertices(std::size_t sequence, std::size_t frame, Batch& batch, std::int64_t n) const;

  const TrainConfig& config_;
  const PairData& data_;
  int remembered_;
  int frames_, scale_, steps_;
  std::vector<Window> windows_;
  std::optional<Mirror> mirror_;
  std::vector<torch::Tensor> constants_;  ///< of each mesh (K, h, w)
  std::vector<torch::Tensor> rest_;       ///< of each mesh (3, V), for losses on vertices
};

}  // namespace pleat::superres
