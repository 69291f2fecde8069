// Inference with a model bundle. Free of LibTorch: link pleat_superres, include this.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "services/superres/bundle/metadata.hpp"

namespace pleat::superres {

enum class Precision {
  kAuto,  ///< bfloat16 where the processor multiplies it natively and the bundle allows it, else float32
  kFloat32,
  kBfloat16,
};

/// "auto", "float32" or "bfloat16"; anything else is kInvalidArgument.
Precision precision_from_string(const std::string& text);

/// True if this processor has bfloat16 dot products (AVX512-BF16 or AMX-BF16).
bool processor_has_bfloat16();

struct EngineOptions {
  std::string folder = "deploy/models";  ///< bundles are code: they are loaded from here and from nowhere else
  Precision precision = Precision::kAuto;
  int threads = 0;           ///< of one inference on the CPU; 0: all processors this process may use
  bool use_cuda = true;      ///< when LibTorch sees a device
  int largest_batch = 4;     ///< images in one inference at most; larger batches are split
  bool torchscript = false;  ///< run the module itself even where the processor's own kernels could: for comparison
};

/// What a loaded bundle runs as.
struct EngineStatus {
  std::string device;     ///< "cpu" or "cuda:0"
  std::string precision;  ///< "float32" or "bfloat16"
  std::string processor;  ///< the processor's own name
  std::string kernels;    ///< "AMX bfloat16", "AVX-512 bfloat16", "AVX-512", "AVX2", or "TorchScript"
  int threads = 0;
  int largest_batch = 0;  ///< smaller than asked for if the device ran out of memory
};

/// What a network reads.
struct NetworkInput {
  const Tensor* frames = nullptr;                ///< (T C, h, w): the window of a frame, normalised
  std::shared_ptr<const Tensor> constants = {};  ///< (K, h, w) from Engine::take_constants(); null where K is 0
  /// Of a network that remembers (Metadata::memory): what the frame before left; empty: there was none.
  std::span<const float> memory = {};
  std::vector<float>* left = nullptr;  ///< gets what this frame leaves, unless null
};

/// One bundle, ready to run. upscale() may be called from several threads; inferences run one at a time.
class Engine {
 public:
  /// Loads, converts, freezes and warms up. Errors as bundle_path and load_bundle; kFailedPrecondition if bfloat16 is
  /// demanded and the processor or the bundle has none.
  Engine(const EngineOptions& options, const std::string& name);
  ~Engine();
  Engine(Engine&&) noexcept;
  Engine& operator=(Engine&&) noexcept;

  const Metadata& describe() const;
  /// Of the moment.
  EngineStatus status() const;

  /// Throws kFailedPrecondition unless the bundle serves the coarse mesh with this topology_hash().
  void require_topology(const std::string& topology_hash) const;

  /// What a stream's networks read beside its frames. Throws kInvalidArgument unless there are as many channels as the
  /// bundle says, all finite; null for none.
  std::shared_ptr<const Tensor> take_constants(Tensor constants) const;

  /// Throws kInvalidArgument, naming what is wrong, unless a network could read this: shapes, counts of values, and
  /// that what it remembers is finite.
  void check(const NetworkInput& input) const;

  /// inputs: of one shape (T C, h, w). Returns for each the first `channels` of the answer, (channels, H, W) without
  /// names; 0: all. h and w are the bundle's or, for bundles that know no mesh (no topology_hash), any size.
  /// kInvalidArgument for sizes that don't fit or values that are not finite; kInternal if the module answers with
  /// another shape. Networks that remember run one input at a time, so that their answers do not depend on whose frames
  /// come with them. If the device runs out of memory, the batch is halved, here and from then on; kResourceExhausted
  /// if one input is too much.
  std::vector<Tensor> upscale(std::span<const NetworkInput> inputs, int channels = 0);
  /// The same into answers, as many as inputs, whose memory is used again if it is large enough.
  void upscale(std::span<const NetworkInput> inputs, int channels, std::span<Tensor* const> answers);
  Tensor upscale(const NetworkInput& input, int channels = 0);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres
