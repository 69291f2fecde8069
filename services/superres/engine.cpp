#include "services/superres/engine.hpp"

#include <ATen/Parallel.h>
#include <torch/script.h>
#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <mutex>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "services/superres/bundle.hpp"
#include "services/superres/cpu/executor.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;

/// The first value of a field of /proc/cpuinfo, or "".
std::string processor_field(const std::string& field) {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(field, 0) == 0) {
      const auto colon = line.find(':');
      if (colon != std::string::npos && colon + 2 <= line.size()) return line.substr(colon + 2);
    }
  }
  return "";
}

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

bool stays_float32(const std::string& name, const std::vector<std::string>& prefixes) {
  return std::any_of(prefixes.begin(), prefixes.end(), [&](const auto& prefix) { return name.rfind(prefix, 0) == 0; });
}

bool out_of_memory(const std::string& text) {
  return text.find("out of memory") != std::string::npos || text.find("can't allocate memory") != std::string::npos;
}

void convert_to_bfloat16(torch::jit::Module& module, const std::vector<std::string>& prefixes) {
  const auto convert = [&](const std::string& name, torch::Tensor tensor) {
    if (tensor.is_floating_point() && !stays_float32(name, prefixes)) tensor.set_data(tensor.to(torch::kBFloat16));
  };
  for (const auto& entry : module.named_parameters()) convert(entry.name, entry.value);
  for (const auto& entry : module.named_buffers()) convert(entry.name, entry.value);
}

}  // namespace

Precision precision_from_string(const std::string& text) {
  if (text == "auto") return Precision::kAuto;
  if (text == "float32") return Precision::kFloat32;
  if (text == "bfloat16") return Precision::kBfloat16;
  throw_invalid_argument("precision must be auto, float32 or bfloat16, is '" + text + "'");
}

std::string to_string(Precision precision) {
  switch (precision) {
    case Precision::kAuto:
      return "auto";
    case Precision::kFloat32:
      return "float32";
    case Precision::kBfloat16:
      return "bfloat16";
  }
  throw_internal("unknown precision");
}

bool processor_has_bfloat16() {
  const std::string flags = " " + processor_field("flags") + " ";
  return flags.find(" avx512_bf16 ") != std::string::npos || flags.find(" amx_bf16 ") != std::string::npos;
}

std::vector<std::string> list_bundles(const std::string& folder) {
  std::error_code error;
  fs::directory_iterator files(folder, error);
  if (error) throw_not_found(folder + ": no folder of model bundles: " + error.message());
  std::vector<std::string> names;
  for (const auto& file : files) {
    if (file.path().extension() == ".pt" && file.is_regular_file(error)) names.push_back(file.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::string bundle_path(const std::string& folder, const std::string& name) {
  const std::string file = name.size() > 3 && name.ends_with(".pt") ? name : name + ".pt";
  if (name.empty() || name.find_first_of(std::string("/\\\0", 3)) != std::string::npos || name.find("..") == 0) {
    throw_invalid_argument("model bundle '" + name + "': only names of files in " + folder + " are allowed");
  }
  std::error_code error;
  const fs::path root = fs::canonical(folder, error);
  if (error) throw_not_found(folder + ": no folder of model bundles: " + error.message());
  const fs::path path = fs::canonical(root / file, error);
  if (error || !fs::is_regular_file(path))
    throw_not_found("model bundle '" + name + "': no file " + folder + "/" + file);
  if (path.parent_path() != root) {
    throw_invalid_argument("model bundle '" + name + "' leads outside " + folder);
  }
  return path.string();
}

Metadata read_metadata(const std::string& folder, const std::string& name) {
  Metadata metadata;
  load_bundle(bundle_path(folder, name), metadata);
  return metadata;
}

struct Engine::State {
  Metadata metadata;
  EngineStatus status;
  torch::Device device = torch::kCPU;
  torch::jit::Module module;
  std::unique_ptr<cpu::Executor> executor;  ///< in place of the module where it can
  std::mutex mutex;

  /// One inference of the module. images: (N, 9, h, w).
  torch::Tensor run_module(const torch::Tensor& images) {
    const c10::InferenceMode inference;
    if (at::get_num_threads() != status.threads) at::set_num_threads(status.threads);
    torch::Tensor output;
    const std::string name = "model bundle '" + metadata.name + "': ";
    try {
      output = module.forward({images.to(device)}).toTensor();
      const auto expected = std::vector<std::int64_t>{images.size(0), kChannels, images.size(2) * metadata.scale,
                                                      images.size(3) * metadata.scale};
      if (output.sizes().vec() != expected) throw_internal(name + "answers with another shape than (N, 9, 4h, 4w)");
      return output.to(torch::kCPU, torch::kFloat32).contiguous();
    } catch (const Error&) {
      throw;
    } catch (const std::exception& error) {
      const auto* torch_error = dynamic_cast<const c10::Error*>(&error);
      const std::string text = torch_error != nullptr ? torch_error->what_without_backtrace() : error.what();
      if (out_of_memory(text)) throw Error(ErrorCode::kResourceExhausted, name + first_line(text));
      throw_internal(name + first_line(text));
    }
  }

  /// Images [begin, end) to results [begin, end), in batches that the device can hold.
  void run_batches(const torch::Tensor& images, std::int64_t begin, std::int64_t end, int channels,
                   std::vector<std::vector<float>>& results) {
    const std::int64_t plane = images.size(2) * images.size(3), fine = plane * metadata.scale * metadata.scale;
    if (executor) {
      for (std::int64_t n = begin; n < end; ++n) {
        auto& result = results[static_cast<std::size_t>(n)];
        result.resize(static_cast<std::size_t>(channels * fine));
        executor->run(images.data_ptr<float>() + n * kChannels * plane, static_cast<int>(images.size(2)),
                      static_cast<int>(images.size(3)), channels, result.data());
      }
      return;
    }
    while (begin < end) {
      const std::int64_t count = std::min<std::int64_t>(end - begin, status.largest_batch);
      torch::Tensor output;
      try {
        output = run_module(images.slice(0, begin, begin + count));
      } catch (const Error& error) {
        if (error.code() != ErrorCode::kResourceExhausted || count == 1) throw;
        status.largest_batch = static_cast<int>(count / 2);
        continue;
      }
      for (std::int64_t n = 0; n < count; ++n) {
        const float* source = output.data_ptr<float>() + n * kChannels * fine;
        results[static_cast<std::size_t>(begin + n)].assign(source, source + channels * fine);
      }
      begin += count;
    }
  }
};

Engine::Engine(const EngineOptions& options, const std::string& name) : state_(std::make_unique<State>()) {
  State& s = *state_;
  const std::string path = bundle_path(options.folder, name);
  s.module = load_bundle(path, s.metadata);
  s.module.eval();

  const bool cuda = options.use_cuda && torch::cuda::is_available();
  if (cuda) s.device = torch::Device(torch::kCUDA, 0);
  const bool processor_can = cuda || processor_has_bfloat16();
  const bool bundle_can = !s.metadata.float32_parameters.empty();
  if (options.precision == Precision::kBfloat16 && !(processor_can && bundle_can)) {
    throw Error(ErrorCode::kFailedPrecondition, processor_can
                                                    ? "model bundle '" + s.metadata.name + "' does not allow bfloat16"
                                                    : "bfloat16: this processor has neither AVX512-BF16 nor AMX");
  }
  const bool bfloat16 = options.precision != Precision::kFloat32 && processor_can && bundle_can;
  s.status.device = cuda ? "cuda:0" : "cpu";
  s.status.precision = bfloat16 ? "bfloat16" : "float32";
  s.status.processor = processor_field("model name");
  s.status.threads = options.threads > 0 ? options.threads : static_cast<int>(available_processors());
  s.status.kernels = "TorchScript";
  s.status.largest_batch = std::max(1, options.largest_batch);

  if (!cuda && !options.torchscript) {
    const cpu::Arrays arrays = arrays_of(s.module);
    if (cpu::Executor::supports(s.metadata.architecture, arrays) && (!bfloat16 || cpu::has_bfloat16())) {
      s.executor = std::make_unique<cpu::Executor>(s.metadata.architecture, arrays,
                                                   cpu::ExecutorOptions{bfloat16, s.status.threads, false});
      s.status.kernels = s.executor->kernels();
      s.module = {};
    }
  }
  if (!s.executor) {
    const torch::NoGradGuard no_grad;
    at::set_num_threads(s.status.threads);
    try {
      if (bfloat16) convert_to_bfloat16(s.module, s.metadata.float32_parameters);
      s.module.to(s.device);
      s.module = torch::jit::freeze(s.module);
      s.module = torch::jit::optimize_for_inference(s.module);
    } catch (const std::exception& error) {
      throw_data_loss(path + ": can't be prepared: " + first_line(error.what()));
    }
  }
  // The first inferences make buffers, and TorchScript optimises in its second; a batch of one must be as warm as a
  // full one.
  const int h = s.metadata.coarse_height, w = s.metadata.coarse_width;
  for (const int batch : {1, s.executor ? 1 : s.status.largest_batch}) {
    const auto input = torch::full({batch, kChannels, h, w}, 0.5);
    for (int i = 0; i < 2; ++i) {
      std::vector<std::vector<float>> results(static_cast<std::size_t>(batch));
      s.run_batches(input, 0, batch, kChannels, results);
      for (const auto& result : results) {
        if (!std::all_of(result.begin(), result.end(), [](float v) { return std::isfinite(v); })) {
          throw_data_loss(path + ": the module answers with values that are not finite");
        }
      }
    }
    if (s.status.largest_batch == 1) break;
  }
}

Engine::~Engine() = default;
Engine::Engine(Engine&&) noexcept = default;
Engine& Engine::operator=(Engine&&) noexcept = default;

const Metadata& Engine::describe() const { return state_->metadata; }
EngineStatus Engine::status() const {
  const std::lock_guard lock(state_->mutex);
  return state_->status;
}

void Engine::require_topology(const std::string& topology_hash) const {
  const std::string& own = state_->metadata.topology_hash;
  if (!own.empty() && own != topology_hash) {
    throw Error(ErrorCode::kFailedPrecondition, "model bundle '" + state_->metadata.name +
                                                    "' was trained for the coarse mesh " + own + ", not for " +
                                                    topology_hash);
  }
}

std::vector<std::vector<float>> Engine::upscale(std::span<const std::span<const float>> images, int height, int width,
                                                int channels) {
  State& s = *state_;
  if (images.empty()) return {};
  if (channels != 3 && channels != kChannels) throw_invalid_argument("fine image: 3 or 9 channels can be asked for");
  if (height < 1 || width < 1 || height > 8192 || width > 8192) {
    throw_invalid_argument("coarse image: " + std::to_string(width) + "x" + std::to_string(height) + " is no size");
  }
  const bool one_size = needs_mesh(s.metadata.architecture);
  if (one_size && (height != s.metadata.coarse_height || width != s.metadata.coarse_width)) {
    throw_invalid_argument("coarse image: " + std::to_string(width) + "x" + std::to_string(height) +
                           ", the bundle serves its own mesh at " + std::to_string(s.metadata.coarse_width) + "x" +
                           std::to_string(s.metadata.coarse_height));
  }
  const std::size_t texels = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  const std::size_t count = kChannels * texels;
  const auto batch = static_cast<std::int64_t>(images.size());
  const auto input = torch::empty({batch, kChannels, height, width}, torch::kFloat32);
  float* target = input.data_ptr<float>();
  for (const auto& image : images) {
    if (image.size() != count) {
      throw_invalid_argument("coarse image: needs " + std::to_string(count) + " values, has " +
                             std::to_string(image.size()));
    }
    if (!std::all_of(image.begin(), image.end(), [](float v) { return std::isfinite(v); })) {
      throw_invalid_argument("coarse image: a value is not finite");
    }
    std::memcpy(target, image.data(), count * sizeof(float));
    target += count;
  }
  std::vector<std::vector<float>> results(images.size());
  const std::lock_guard lock(s.mutex);
  s.run_batches(input, 0, batch, channels, results);
  return results;
}

std::vector<float> Engine::upscale(std::span<const float> image, int height, int width, int channels) {
  const std::span<const float> one[] = {image};
  return std::move(upscale(std::span<const std::span<const float>>(one), height, width, channels).front());
}

Tensor Engine::upscale(const Tensor& image, int channels) {
  if (image.shape.size() != 3 || image.shape[0] != kChannels ||
      (!image.channels.empty() && image.channels != state_->metadata.channels)) {
    throw_invalid_argument("coarse image: needs shape (9, h, w) with displacement, normal and velocity channels");
  }
  if (image.shape[1] < 1 || image.shape[1] > 8192 || image.shape[2] < 1 || image.shape[2] > 8192) {
    throw_invalid_argument("coarse image: its height or width is no size");
  }
  Tensor result;
  result.values = upscale(image.values, static_cast<int>(image.shape[1]), static_cast<int>(image.shape[2]), channels);
  result.shape = {channels, image.shape[1] * kScale, image.shape[2] * kScale};
  result.channels.assign(state_->metadata.channels.begin(), state_->metadata.channels.begin() + channels);
  return result;
}

}  // namespace pleat::superres
