// A network with its gradients, on the processor and without LibTorch: what Executor is for inference.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "services/superres/networks/description.hpp"

namespace pleat::superres::kernels {

struct TrainableOptions {
  Size input;                      ///< texels
  bool bfloat16 = false;           ///< all layers but the exact ones; needs has_bfloat16()
  int threads = 1;                 ///< one image each
  bool base_instructions = false;  ///< only those that the program is built for, and no tiles; for tests
};

/// Not thread-safe.
class Trainable {
 public:
  /// False for layers whose gradients are not known here, or beyond the kernels' sizes.
  static bool supports(const Description& network);

  Trainable(const Description& network, const TrainableOptions& options);
  ~Trainable();

  const TrainableOptions& options() const;
  Size output_size() const;

  /// Takes the parameters as they are now, in LibTorch's order: weights (out, in, k, k), biases (out).
  void load(const std::function<const float*(const std::string& name)>& find);

  /// input: (count, inputs, h, w), output: (count, outputs, H, W). Keeps what backward() needs if asked to.
  void forward(const float* input, int count, float* output, bool keep);

  /// gradient: of the outputs of the last forward() that kept. Adds to the gradients that `find` names. The sums over
  /// images are in an order that depends on the number of threads only.
  void backward(const float* gradient, const std::function<float*(const std::string& name)>& find);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::kernels
