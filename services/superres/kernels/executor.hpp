// Inference on the processor without LibTorch: the same function as Network::forward, several times as fast.
#pragma once

#include <memory>
#include <span>

#include "services/superres/kernels/forward.hpp"

namespace pleat::superres::kernels {

struct ExecutorOptions {
  bool bfloat16 = false;  ///< layers that are not exact; needs has_bfloat16()
  /// At most. An image takes all of them or one, whichever was faster lately: threads that meet at every layer wait for
  /// each other long where something else runs on the same processors. The result is the same, bit for bit.
  int threads = 1;
  bool base_instructions = false;  ///< only those that the program is built for, and no tiles; for tests
};

/// One network. Not thread-safe: one inference at a time.
class Executor {
 public:
  /// False for networks beyond the kernels' sizes. Others go through TorchScript.
  static bool supports(const Description& network);

  /// Throws kInvalidArgument naming a parameter of another size, kFailedPrecondition for bfloat16 without
  /// has_bfloat16(). parameters: are asked for again when the size of the input changes.
  Executor(const Description& network, FindValues parameters, const ExecutorOptions& options);
  ~Executor();

  /// The name of the kernels of the body.
  const char* kernels() const;

  /// frames: (inputs - K, h, w), and constants: (K, h, w), which are the input's last channels; whoever changes their
  /// values changes their address. output: (channels, H, W), the first ones of the answer.
  void run(const float* frames, std::span<const float> constants, Size size, int channels, float* output);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::kernels
