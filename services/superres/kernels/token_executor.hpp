// Inference on the processor without LibTorch of networks whose layers work on places one by one or let them look at
// one another: the same function as Network::forward.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "services/superres/kernels/forward.hpp"

namespace pleat::superres::kernels {

/// What a network that remembers is given and leaves, of Description::memory_shape() each.
struct TokenMemory {
  std::span<const float> before;        ///< empty: zeros
  std::vector<float>* after = nullptr;  ///< null: not wanted
};

/// One network, in float32. Keeps buffers from one inference to the next, and nothing else. Not thread-safe.
class TokenExecutor {
 public:
  /// Whether every layer that an answer needs is a convolution with kernel 1, a norm, attention, memory, or moves
  /// values about. Others go through Executor or TorchScript.
  static bool supports(const Description& network);

  /// Throws kInvalidArgument naming a parameter of another size. threads: at most; they share large layers, and change
  /// no bit.
  TokenExecutor(const Description& network, const FindValues& parameters, int threads);
  ~TokenExecutor();

  /// As Executor::run(). O(places x weights), and places^2 x features for attention between places.
  void run(const float* frames, std::span<const float> constants, Size size, int channels, float* output,
           const TokenMemory& memory = {});

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::kernels
