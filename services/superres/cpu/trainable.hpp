// A network's convolutions with their gradients, on the processor and without LibTorch: what Executor is for inference.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "services/superres/metadata.hpp"

namespace pleat::superres::cpu {

/// Where a parameter and its gradient lie, in LibTorch's order: weights (out, in, k, k), biases (out).
struct Parameter {
  const float* value = nullptr;
  float* gradient = nullptr;
};

struct TrainableOptions {
  int inputs = 0;  ///< channels of the network's input
  int height = 0, width = 0;
  bool bfloat16 = false;           ///< all convolutions but the shallow ones; needs has_bfloat16()
  int threads = 1;                 ///< one image each
  bool base_instructions = false;  ///< only those that the program is built for, for tests
};

/// From the conditioned input to the answer of the heads (upsampling "subpixel") or to the features before they are
/// upsampled ("bilinear"). Not thread-safe.
class Trainable {
 public:
  static bool supports(const Architecture& architecture);

  Trainable(const Architecture& architecture, const TrainableOptions& options);
  ~Trainable();

  const TrainableOptions& options() const;
  int outputs() const;

  /// Takes the parameters as they are now. Names as in Network::parameters().
  void load(const std::function<Parameter(const std::string&)>& find);

  /// input: (count, inputs, h, w), output: (count, outputs, h, w). Keeps what backward() needs if asked to.
  void forward(const float* input, int count, float* output, bool keep);

  /// gradient: of the outputs of the last forward() that kept. Adds to the gradients that `find` names. The sums over
  /// images are in an order that depends on the number of threads only.
  void backward(const float* gradient, const std::function<Parameter(const std::string&)>& find);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres::cpu
