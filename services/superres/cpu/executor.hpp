// Inference on the processor without LibTorch: the same function as Network::forward, several times as fast.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "services/superres/cpu/kernels.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres::cpu {

/// A parameter or constant of a network, by its name in the TorchScript module.
struct Array {
  std::vector<std::int64_t> shape;
  std::vector<float> values;          ///< of floating-point arrays
  std::vector<std::int64_t> indices;  ///< of integer arrays
};
using Arrays = std::map<std::string, Array>;

struct ExecutorOptions {
  bool bfloat16 = false;  ///< convolutions behind the shallow ones; needs has_bfloat16()
  /// At most. An image takes all of them or one, whichever was faster lately: threads that meet at every layer wait for
  /// each other long where something else runs on the same processors. The result is the same, bit for bit.
  int threads = 1;
  bool base_instructions = false;  ///< only those that the program is built for, for tests
};

/// One network. Not thread-safe: one inference at a time.
class Executor {
 public:
  /// True for the architectures and sizes that run here. Others go through TorchScript.
  static bool supports(const Architecture& architecture, const Arrays& arrays);

  /// arrays: those of Network::to_script(). Throws kInvalidArgument naming the array that is missing or has another
  /// shape, kFailedPrecondition for bfloat16 without has_bfloat16().
  Executor(const Architecture& architecture, const Arrays& arrays, const ExecutorOptions& options);
  ~Executor();

  /// The name of the kernels of the body.
  const char* kernels() const;

  /// image: (9, height, width) normalised; height, width >= 2, and those of the bundle with residual "mesh".
  /// output: the first `channels` (3 or 9) of (9, 4 height, 4 width).
  void run(const float* image, int height, int width, int channels, float* output);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::cpu
