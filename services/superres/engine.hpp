// Inference with a model bundle. Free of LibTorch: link pleat_superres, include this.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres {

enum class Precision {
  kAuto,  ///< bfloat16 where the processor multiplies it natively and the bundle allows it, else float32
  kFloat32,
  kBfloat16,
};

/// "auto", "float32" or "bfloat16"; anything else is kInvalidArgument.
Precision precision_from_string(const std::string& text);
std::string to_string(Precision precision);

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
  std::string kernels;    ///< "AVX-512 bfloat16", "AVX-512", "AVX2", or "TorchScript"
  int threads = 0;
  int largest_batch = 0;  ///< smaller than asked for if the device ran out of memory
};

/// Lists the bundles of a folder: names without ".pt", sorted. kNotFound if the folder does not exist.
std::vector<std::string> list_bundles(const std::string& folder);

/// The file of bundle `name` ("draping" or "draping.pt") in `folder`. kInvalidArgument for a name with a path in it or
/// "..", or a link that leads outside; kNotFound if there is no such file.
std::string bundle_path(const std::string& folder, const std::string& name);

/// Reads the metadata only. Errors as metadata_from_json; kDataLoss for a truncated or unreadable archive,
/// kInvalidArgument for a TorchScript file without pleat.json.
Metadata read_metadata(const std::string& folder, const std::string& name);

/// One bundle, ready to run. upscale() may be called from several threads; inferences run one at a time.
class Engine {
 public:
  /// Loads, converts, freezes and warms up. Errors as bundle_path and read_metadata; kFailedPrecondition if bfloat16 is
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

  /// images: N normalised coarse images, each (9, h, w) float32 row-major; returns N fine images, the first `channels`
  /// (9, or 3: displacements alone take less time) of (9, 4h, 4w).
  /// h and w are the bundle's or, for bundles that know no mesh (residual "mesh"), any size. kInvalidArgument for sizes
  /// that don't fit or values that are not finite; kInternal if the module answers with another shape. If the device
  /// runs out of memory, the batch is halved, here and from then on; kResourceExhausted if one image is too much.
  std::vector<std::vector<float>> upscale(std::span<const std::span<const float>> images, int height, int width,
                                          int channels = kChannels);
  std::vector<float> upscale(std::span<const float> image, int height, int width, int channels = kChannels);

  /// The same for a frame's tensor: shape (9, h, w) with the bundle's channel names.
  Tensor upscale(const Tensor& image, int channels = kChannels);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat::superres
