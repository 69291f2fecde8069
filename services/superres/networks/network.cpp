#include "services/superres/networks/network.hpp"

#include <torch/script.h>

#include <cmath>

#include "common/base/error.hpp"
#include "common/base/random.hpp"
#include "services/superres/kernels/kernels.hpp"
#include "services/superres/networks/script.hpp"

namespace pleat::superres {
namespace {

torch::Tensor uniform(std::vector<std::int64_t> shape, double bound, std::uint64_t& state) {
  auto tensor = torch::empty(shape);
  float* values = tensor.data_ptr<float>();
  for (std::int64_t i = 0; i < tensor.numel(); ++i) {
    const double unit = unit_interval(split_mix(state));
    values[i] = static_cast<float>(bound * (2 * unit - 1));
  }
  return tensor.set_requires_grad(true);
}

/// (N, frames C, h, w) -> (N frames, C, h, w)
torch::Tensor split_frames(const torch::Tensor& x, int frames) {
  return frames == 1 ? x : x.reshape({-1, x.size(1) / frames, x.size(2), x.size(3)});
}

torch::Tensor normalized(const torch::Tensor& x, const Layer& layer, const torch::Tensor& weight,
                         const torch::Tensor& bias) {
  const std::int64_t channels = layer.channels / layer.frames;
  const auto places = x.reshape({-1, channels, x.size(2) * x.size(3)}).transpose(1, 2);
  return torch::layer_norm(places, {channels}, weight, bias).transpose(1, 2).reshape(x.sizes());
}

torch::Tensor attention(const torch::Tensor& x, const Layer& layer) {
  const std::int64_t frames = layer.frames, heads = layer.heads, width = layer.channels / (frames * heads);
  const double scale = 1 / std::sqrt(static_cast<double>(width));
  const auto parts = x.reshape({-1, frames, 3, heads, width, x.size(2) * x.size(3)});
  const auto q = parts.select(2, 0), k = parts.select(2, 1), v = parts.select(2, 2);  // (N, T, heads, width, places)
  torch::Tensor result;
  if (layer.over_frames) {
    const auto weights = torch::softmax((q.unsqueeze(2) * k.unsqueeze(1)).sum(4) * scale, 2);
    result = (weights.unsqueeze(4) * v.unsqueeze(1)).sum(2);
  } else {
    const auto weights = torch::softmax(torch::matmul(q.transpose(3, 4), k) * scale, -1);
    result = torch::matmul(v, weights.transpose(3, 4));
  }
  return result.reshape({x.size(0), layer.channels, x.size(2), x.size(3)});
}

torch::Tensor resize(const torch::Tensor& x, std::int64_t height, std::int64_t width) {
  return torch::upsample_bilinear2d(x, {height, width}, false);
}

/// The own kernels as a function that autograd knows. Activations stay in the Trainable.
struct OwnKernels : torch::autograd::Function<OwnKernels> {
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& input,
                               at::TensorList parameters, const Network* network, bool keep) {
    kernels::Trainable& trainable = *network->trainable();
    trainable.load([&](const std::string& name) -> const float* { return find(*network, parameters, name); });
    const Size size = trainable.output_size();
    auto output = torch::empty({input.size(0), network->description().outputs(), size.height, size.width});
    trainable.forward(input.contiguous().data_ptr<float>(), static_cast<int>(input.size(0)), output.data_ptr<float>(),
                      keep);
    context->saved_data["network"] = reinterpret_cast<std::int64_t>(network);
    return output;
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list gradients) {
    const auto* network = reinterpret_cast<const Network*>(context->saved_data["network"].toInt());
    // Nothing for the input, the network and the flag.
    torch::autograd::variable_list result{{}};
    for (const auto& [name, value] : network->parameters()) result.push_back(torch::zeros_like(value));
    const std::vector<torch::Tensor> own(result.begin() + 1, result.end());
    network->trainable()->backward(gradients[0].contiguous().data_ptr<float>(),
                                   [&](const std::string& name) { return find(*network, own, name); });
    result.insert(result.end(), 2, torch::Tensor());
    return result;
  }

  static float* find(const Network& network, at::TensorList values, const std::string& name) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (network.parameters()[i].first == name) return values[i].data_ptr<float>();
    }
    throw_internal("network: no parameter " + name);
  }
};

}  // namespace

torch::Tensor upsample_bilinear(const torch::Tensor& x, int factor) {
  return resize(x, x.size(2) * factor, x.size(3) * factor);
}

Network::Network(const Description& description, std::uint64_t seed) : description_(description) {
  std::uint64_t state = seed;
  for (const Layer& layer : description_.layers) {
    if (layer.kind == LayerKind::kNorm) {
      const std::int64_t channels = layer.channels / layer.frames;
      parameters_.emplace_back(layer.name + "_weight", torch::ones({channels}).set_requires_grad(true));
      parameters_.emplace_back(layer.name + "_bias", torch::zeros({channels}).set_requires_grad(true));
    }
    if (layer.kind != LayerKind::kConvolution) continue;
    const std::int64_t in = description_.input_channels(layer) / layer.frames, out = layer.channels / layer.frames,
                       k = layer.kernel;
    const double bound = layer.zero ? 0.0 : 1.0 / std::sqrt(static_cast<double>(in * k * k));
    parameters_.emplace_back(layer.name + "_weight", uniform({out, in, k, k}, bound, state));
    parameters_.emplace_back(layer.name + "_bias", uniform({out}, bound, state));
    if (layer.activation == Activation::kPrelu) {
      parameters_.emplace_back(layer.name + "_slope", torch::full({out}, 0.25).set_requires_grad(true));
    }
  }
}

const torch::Tensor& Network::get(const std::string& name) const {
  for (const auto& [key, value] : parameters_) {
    if (key == name) return value;
  }
  throw_internal("network: no parameter " + name);
}

torch::Tensor Network::layer_forward(const Layer& layer, const std::vector<torch::Tensor>& values,
                                     torch::ScalarType body) const {
  const auto value = [&](int index) { return values[static_cast<std::size_t>(index)]; };
  const auto& first = value(layer.inputs[0]);
  switch (layer.kind) {
    case LayerKind::kPixelShuffle:
      return torch::pixel_shuffle(first, layer.factor);
    case LayerKind::kUpsample:
      return upsample_bilinear(first, layer.factor);
    case LayerKind::kPool:
      return torch::avg_pool2d(first, layer.factor, layer.factor, 0, true, false);
    case LayerKind::kResize:
      return resize(first, value(layer.like).size(2), value(layer.like).size(3));
    case LayerKind::kAttention:
      return attention(first, layer);
    case LayerKind::kNorm:
    case LayerKind::kConvolution:
      break;
  }
  // No copies where the types agree already.
  const auto type = layer.exact ? torch::kFloat32 : body;
  if (layer.kind == LayerKind::kNorm) {
    const auto y =
        normalized(first.to(type), layer, get(layer.name + "_weight").to(type), get(layer.name + "_bias").to(type));
    return layer.add >= 0 ? y + value(layer.add).to(type) : y;
  }
  std::vector<torch::Tensor> parts;
  for (const int index : layer.inputs) parts.push_back(value(index).to(type));
  const auto x = parts.size() > 1 ? torch::cat(parts, 1) : parts[0];
  auto y = torch::conv2d(split_frames(x, layer.frames), get(layer.name + "_weight").to(type),
                         get(layer.name + "_bias").to(type), 1, layer.kernel / 2);
  if (layer.frames > 1) y = y.reshape({x.size(0), layer.channels, y.size(2), y.size(3)});
  if (layer.add >= 0) y = y + value(layer.add).to(type);
  if (layer.activation == Activation::kRelu) return torch::relu(y);
  if (layer.activation == Activation::kNone) return y;
  const auto slope = get(layer.name + "_slope").to(type).view({1, -1, 1, 1});
  return torch::relu(y) - slope * torch::relu(-y);
}

torch::Tensor Network::own_forward(const torch::Tensor& x, bool bfloat16) const {
  const kernels::TrainableOptions options{
      {static_cast<int>(x.size(2)), static_cast<int>(x.size(3))}, bfloat16, own_threads_, false};
  if (!trainable_ || trainable_->options().input != options.input || trainable_->options().bfloat16 != bfloat16) {
    trainable_ = std::make_shared<kernels::Trainable>(description_, options);
  }
  const auto values = parameter_values();
  return OwnKernels::apply(x, at::TensorList(values), this, torch::GradMode::is_enabled());
}

torch::Tensor Network::forward(const torch::Tensor& x, torch::ScalarType body) const {
  const bool bfloat16 = body == torch::kBFloat16;
  if (own_threads_ > 0 && x.device().is_cpu() && (!bfloat16 || kernels::has_bfloat16()) &&
      kernels::Trainable::supports(description_)) {
    return own_forward(x, bfloat16);
  }
  std::vector<torch::Tensor> values{x};
  for (const Layer& layer : description_.layers) values.push_back(layer_forward(layer, values, body));
  return values.back().to(x.scalar_type());
}

void Network::use_own_kernels(int threads) {
  own_threads_ = threads;
  trainable_.reset();
}

std::vector<torch::Tensor> Network::parameter_values() const {
  std::vector<torch::Tensor> values;
  for (const auto& entry : parameters_) values.push_back(entry.second);
  return values;
}

std::int64_t Network::parameter_count() const {
  std::int64_t count = 0;
  for (const auto& entry : parameters_) count += entry.second.numel();
  return count;
}

void Network::to(torch::Device device) {
  for (auto& entry : parameters_) entry.second = entry.second.detach().to(device).set_requires_grad(true);
}

std::vector<std::string> Network::float32_parameters() const {
  std::vector<std::string> names;
  for (const Layer& layer : description_.layers) {
    const bool has_parameters = layer.kind == LayerKind::kConvolution || layer.kind == LayerKind::kNorm;
    if (layer.exact && has_parameters) names.push_back(layer.name + "_");
  }
  return names;
}

torch::jit::Module Network::to_script() const {
  const torch::NoGradGuard no_grad;
  torch::jit::Module module("PleatNetwork");
  for (const auto& [name, value] : parameters_) {
    module.register_parameter(name, value.detach().to(torch::kCPU).clone(), false);
  }
  module.define(script_of(description_));
  module.eval();
  return module;
}

}  // namespace pleat::superres
