#include "services/superres/engine.hpp"

#include <ATen/Parallel.h>
#include <torch/script.h>
#include <torch/torch.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <map>
#include <mutex>
#include <optional>
#include <utility>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/kernels/executor.hpp"
#include "services/superres/kernels/token_executor.hpp"
#include "services/superres/networks/torch_threads.hpp"

namespace pleat::superres {
namespace {

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

constexpr std::int64_t kLargestSide = 8192;
constexpr std::int64_t kAnySide = 16;  ///< of the images that warm a bundle up which serves any size

std::vector<Tensor*> addresses(std::vector<Tensor>& tensors) {
  std::vector<Tensor*> result;
  for (Tensor& tensor : tensors) result.push_back(&tensor);
  return result;
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

bool processor_has_bfloat16() {
  const std::string flags = " " + processor_field("flags") + " ";
  return flags.find(" avx512_bf16 ") != std::string::npos || flags.find(" amx_bf16 ") != std::string::npos;
}

struct Engine::State {
  Metadata metadata;
  Ports ports;
  EngineStatus status;
  torch::Device device = torch::kCPU;
  torch::jit::Module module;
  // One of them in place of the module where it can.
  std::unique_ptr<kernels::Executor> executor;
  std::unique_ptr<kernels::TokenExecutor> token_executor;
  std::shared_ptr<const Tensor> constants_in_use;
  std::mutex mutex;

  /// Height and width of what the bundle reads, if it says so.
  std::optional<std::array<std::int64_t, 2>> own_size() const {
    const auto& size = metadata.input_size;
    if (size[0] > 0 && size[1] > 0) return {{size[0], size[1]}};
    return conversion::answer_form(metadata.representation).input_size;
  }

  std::vector<std::int64_t> answer_shape(const std::vector<std::int64_t>& frames, int channels) const {
    return {channels, frames[1] * ports.scale, frames[2] * ports.scale};
  }

  bool remembers() const { return memory_values(metadata) > 0; }

  /// What one input's network remembers, (1, channels, height, width).
  torch::Tensor memory_of(const NetworkInput& input) const {
    const auto& m = metadata.memory;
    auto memory = torch::zeros({1, m[0], m[1], m[2]}, torch::kFloat32);
    std::copy(input.memory.begin(), input.memory.end(), memory.data_ptr<float>());
    return memory;
  }

  /// The module's answer; of a network that remembers `memory` becomes what it remembers then.
  torch::Tensor call_module(const torch::Tensor& input, torch::Tensor& memory) {
    if (!memory.defined()) return module.forward({input.to(device)}).toTensor();
    const auto both = module.forward({input.to(device), memory.to(device)}).toTuple();
    const auto after = both->elements()[1].toTensor().to(torch::kCPU, torch::kFloat32).contiguous();
    if (after.sizes() != memory.sizes()) {
      throw_internal("model bundle '" + metadata.name + "': remembers something of another shape than it should");
    }
    memory = after;
    return both->elements()[0].toTensor();
  }

  /// One inference of the module. input: (N, T C + K, h, w). Returns (N, outputs, H, W).
  torch::Tensor run_module(const torch::Tensor& input, torch::Tensor& memory) {
    const c10::InferenceMode inference;
    if (at::get_num_threads() != status.threads) set_torch_threads(status.threads);
    const std::string name = "model bundle '" + metadata.name + "': ";
    try {
      const auto output = call_module(input, memory);
      auto expected = answer_shape(input.sizes().slice(1).vec(), ports.outputs);
      expected.insert(expected.begin(), input.size(0));
      if (output.sizes().vec() != expected) throw_internal(name + "answers with another shape than it should");
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

  /// (N, T C + K, h, w)
  torch::Tensor stack(std::span<const NetworkInput> inputs) const {
    const Tensor& first = *inputs.front().frames;
    auto input = torch::empty({static_cast<std::int64_t>(inputs.size()), ports.inputs, first.shape[1], first.shape[2]},
                              torch::kFloat32);
    float* target = input.data_ptr<float>();
    for (const NetworkInput& one : inputs) {
      target = std::copy(one.frames->values.begin(), one.frames->values.end(), target);
      if (one.constants) target = std::copy(one.constants->values.begin(), one.constants->values.end(), target);
    }
    return input;
  }

  bool has_own() const { return executor || token_executor; }

  void run_own(std::span<const NetworkInput> inputs, int channels, std::span<Tensor* const> answers) {
    for (std::size_t n = 0; n < inputs.size(); ++n) {
      const Tensor& frames = *inputs[n].frames;
      const std::span<const float> constants =
          inputs[n].constants ? std::span<const float>(inputs[n].constants->values) : std::span<const float>();
      const Size size{static_cast<int>(frames.shape[1]), static_cast<int>(frames.shape[2])};
      if (token_executor) {
        token_executor->run(frames.values.data(), constants, size, channels, answers[n]->values.data(),
                            {inputs[n].memory, inputs[n].left});
        continue;
      }
      executor->run(frames.values.data(), constants, size, channels, answers[n]->values.data());
      // The executor knows them by their address: it may not become another's.
      constants_in_use = inputs[n].constants;
    }
  }

  /// In batches that the device can hold.
  void run(std::span<const NetworkInput> inputs, int channels, std::span<Tensor* const> answers) {
    for (Tensor* answer : answers) {
      answer->shape = answer_shape(inputs.front().frames->shape, channels);
      answer->values.resize(static_cast<std::size_t>(answer->shape[0] * answer->shape[1] * answer->shape[2]));
    }
    if (has_own()) return run_own(inputs, channels, answers);
    for (std::size_t begin = 0; begin < inputs.size();) {
      const std::size_t count =
          remembers() ? 1 : std::min(inputs.size() - begin, static_cast<std::size_t>(status.largest_batch));
      torch::Tensor output, memory;
      if (remembers()) memory = memory_of(inputs[begin]);
      try {
        output = run_module(stack(inputs.subspan(begin, count)), memory);
      } catch (const Error& error) {
        if (error.code() != ErrorCode::kResourceExhausted || count == 1) throw;
        status.largest_batch = static_cast<int>(count / 2);
        continue;
      }
      for (std::size_t n = 0; n < count; ++n) {
        auto& values = answers[begin + n]->values;
        const auto one = output[static_cast<std::int64_t>(n)];
        std::copy_n(one.data_ptr<float>(), values.size(), values.begin());
      }
      if (memory.defined() && inputs[begin].left != nullptr) {
        inputs[begin].left->assign(memory.data_ptr<float>(), memory.data_ptr<float>() + memory.numel());
      }
      begin += count;
    }
  }

  /// The first inferences make buffers, and TorchScript optimises in its second; a batch of one must be as warm as a
  /// full one.
  void warm_up(const std::string& path) {
    const auto [h, w] = own_size().value_or(std::array{kAnySide, kAnySide});
    const auto filled = [&](std::int64_t channels) {
      return Tensor{{channels, h, w}, {}, std::vector<float>(static_cast<std::size_t>(channels * h * w), 0.5F)};
    };
    const Tensor frames = filled(ports.inputs - metadata.constants);
    const auto constants =
        metadata.constants > 0 ? std::make_shared<const Tensor>(filled(metadata.constants)) : nullptr;
    for (const int batch : {1, has_own() ? 1 : status.largest_batch}) {
      const std::vector<NetworkInput> inputs(static_cast<std::size_t>(batch), NetworkInput{&frames, constants});
      std::vector<Tensor> results(inputs.size());
      const std::vector<Tensor*> answers = addresses(results);
      for (int i = 0; i < 2; ++i) {
        run(inputs, ports.outputs, answers);
        for (const Tensor& result : results) {
          if (!all_finite(result.values))
            throw_data_loss(path + ": the module answers with values that are not finite");
        }
      }
      if (status.largest_batch == 1) break;
    }
  }
};

Engine::Engine(const EngineOptions& options, const std::string& name) : state_(std::make_unique<State>()) {
  State& s = *state_;
  const std::string path = bundle_path(options.folder, name);
  s.module = load_bundle(path, s.metadata);
  s.ports = ports_of(s.metadata);
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

  const bool registered = is_registered(s.metadata.architecture.kind);
  if (!cuda && !options.torchscript && registered) {
    const Description network = superres::describe(s.metadata.architecture, s.ports);
    const bool tokens = !network.ends_only && kernels::TokenExecutor::supports(network);
    const bool image = !network.ends_only && !s.remembers() && (!bfloat16 || kernels::has_bfloat16()) &&
                       kernels::Executor::supports(network);
    if (tokens || image) {
      const auto values = std::make_shared<const std::map<std::string, std::vector<float>>>(values_of(s.module));
      const auto find = [values](const std::string& parameter) -> std::span<const float> {
        const auto found = values->find(parameter);
        if (found == values->end()) return {};
        return found->second;
      };
      if (tokens) {
        s.token_executor = std::make_unique<kernels::TokenExecutor>(network, find, s.status.threads);
        s.status.kernels = "own, tokens";
        s.status.precision = "float32";
      } else {
        s.executor = std::make_unique<kernels::Executor>(network, find,
                                                         kernels::ExecutorOptions{bfloat16, s.status.threads, false});
        s.status.kernels = s.executor->kernels();
      }
      s.module = {};
    }
  }
  if (!s.has_own()) {
    const torch::NoGradGuard no_grad;
    set_torch_threads(s.status.threads);
    try {
      if (bfloat16) convert_to_bfloat16(s.module, s.metadata.float32_parameters);
      s.module.to(s.device);
      s.module = torch::jit::freeze(s.module);
      s.module = torch::jit::optimize_for_inference(s.module);
    } catch (const std::exception& error) {
      throw_data_loss(path + ": can't be prepared: " + first_line(error.what()));
    }
  }
  s.warm_up(path);
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

std::shared_ptr<const Tensor> Engine::take_constants(Tensor constants) const {
  const int expected = state_->metadata.constants;
  const std::int64_t channels = constants.shape.empty() ? 0 : constants.shape[0];
  if (channels != expected || (expected > 0 && constants.shape.size() != 3)) {
    throw_invalid_argument("constants: " + std::to_string(channels) + " channels, the bundle reads " +
                           std::to_string(expected));
  }
  if (expected == 0) return nullptr;
  if (static_cast<std::int64_t>(constants.values.size()) != channels * constants.shape[1] * constants.shape[2]) {
    throw_invalid_argument("constants: not as many values as the shape says");
  }
  if (!all_finite(constants.values)) throw_invalid_argument("constants: a value is not finite");
  return std::make_shared<const Tensor>(std::move(constants));
}

void Engine::check(const NetworkInput& input) const {
  const State& s = *state_;
  const auto& shape = input.frames->shape;
  const int channels = s.ports.inputs - s.metadata.constants;
  if (shape.size() != 3 || shape[0] != channels) {
    throw_invalid_argument("image: needs shape (" + std::to_string(channels) + ", h, w)");
  }
  const std::string size = std::to_string(shape[2]) + "x" + std::to_string(shape[1]);
  if (shape[1] < 1 || shape[2] < 1 || shape[1] > kLargestSide || shape[2] > kLargestSide) {
    throw_invalid_argument("image: " + size + " is no size");
  }
  const auto own = s.metadata.topology_hash.empty() ? std::nullopt : s.own_size();
  if (own && (shape[1] != (*own)[0] || shape[2] != (*own)[1])) {
    throw_invalid_argument("image: " + size + ", the bundle serves its own mesh at " + std::to_string((*own)[1]) + "x" +
                           std::to_string((*own)[0]));
  }
  if (static_cast<std::int64_t>(input.frames->values.size()) != shape[0] * shape[1] * shape[2]) {
    throw_invalid_argument("image: needs " + std::to_string(shape[0] * shape[1] * shape[2]) + " values, has " +
                           std::to_string(input.frames->values.size()));
  }
  const std::size_t remembered = memory_values(s.metadata);
  if (!input.memory.empty() && input.memory.size() != remembered) {
    throw_invalid_argument("state: " + std::to_string(input.memory.size()) + " numbers, the bundle remembers " +
                           std::to_string(remembered));
  }
  if (!all_finite(input.memory)) throw_invalid_argument("state: a number is not finite");
  if (!input.constants) {
    if (s.metadata.constants > 0) throw_invalid_argument("constants: the bundle reads some, the session has none");
  } else if (input.constants->shape[1] != shape[1] || input.constants->shape[2] != shape[2]) {
    throw_invalid_argument("image: " + size + ", the session's constants have another size");
  }
}

void Engine::upscale(std::span<const NetworkInput> inputs, int channels, std::span<Tensor* const> answers) {
  State& s = *state_;
  if (inputs.empty()) return;
  if (inputs.size() != answers.size()) throw_internal("a batch needs as many answers as inputs");
  if (channels < 0 || channels > s.ports.outputs) {
    throw_invalid_argument("answer: at most " + std::to_string(s.ports.outputs) + " channels can be asked for");
  }
  for (const NetworkInput& input : inputs) {
    check(input);
    if (input.frames->shape != inputs.front().frames->shape) throw_internal("a batch of images of several sizes");
    if (!all_finite(input.frames->values)) throw_invalid_argument("image: a value is not finite");
  }
  const std::lock_guard lock(s.mutex);
  s.run(inputs, channels == 0 ? s.ports.outputs : channels, answers);
}

std::vector<Tensor> Engine::upscale(std::span<const NetworkInput> inputs, int channels) {
  std::vector<Tensor> results(inputs.size());
  upscale(inputs, channels, addresses(results));
  return results;
}

Tensor Engine::upscale(const NetworkInput& input, int channels) {
  return std::move(upscale(std::span<const NetworkInput>(&input, 1), channels).front());
}

}  // namespace pleat::superres
