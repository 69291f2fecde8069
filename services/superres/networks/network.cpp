#include "services/superres/networks/network.hpp"

#include <torch/script.h>

#include <algorithm>
#include <cmath>
#include <set>

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

constexpr double kLeak = 0.02;    ///< of Activation::kLeakyRelu
constexpr double kHidden = -1e9;  ///< score of a frame that may not be seen

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

/// x: queries, keys and values; or queries alone, and `others` keys and values.
torch::Tensor attention(const torch::Tensor& x, const torch::Tensor& others, const Layer& layer) {
  const std::int64_t frames = layer.frames, heads = layer.heads, width = layer.channels / (frames * heads);
  const double scale = 1 / std::sqrt(static_cast<double>(width));
  const auto parted = [&](const torch::Tensor& t, std::int64_t parts) {
    return t.reshape({-1, frames, parts, heads, width, t.size(2) * t.size(3)});
  };
  const auto first = parted(x, others.defined() ? 1 : 3);
  const auto rest = others.defined() ? parted(others, 2) : first.slice(2, 1);
  const auto q = first.select(2, 0), k = rest.select(2, 0), v = rest.select(2, 1);  // (N, T, heads, width, places)
  torch::Tensor result;
  if (layer.over_frames) {
    auto scores = (q.unsqueeze(2) * k.unsqueeze(1)).sum(4) * scale;
    if (layer.causal) {
      scores =
          scores + torch::triu(torch::full({frames, frames}, kHidden, x.options()), 1).view({frames, frames, 1, 1});
    }
    const auto weights = torch::softmax(scores, 2);
    result = (weights.unsqueeze(4) * v.unsqueeze(1)).sum(2);
  } else {
    const auto weights = torch::softmax(torch::matmul(q.transpose(3, 4), k) * scale, -1);
    result = torch::matmul(v, weights.transpose(3, 4));
  }
  return result.reshape({x.size(0), layer.channels, x.size(2), x.size(3)});
}

torch::Tensor spread(const torch::Tensor& x, const Layer& layer) {
  const std::int64_t channels = layer.channels / layer.frames, places = x.size(2) * x.size(3);
  return x.slice(1, 0, layer.frames * layer.parts * layer.each)
      .reshape({-1, layer.frames, layer.parts, layer.each, places})
      .slice(3, 0, channels)
      .transpose(2, 3)
      .reshape({x.size(0), layer.channels, 1, layer.parts * places});
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

/// (rows, places of the input)
torch::Tensor sparse_mean(const PlaceMap& map) {
  std::vector<std::int64_t> rows;
  std::vector<float> shares;
  for (std::int64_t row = 0; row < map.rows(); ++row) {
    const auto r = static_cast<std::size_t>(row);
    const std::int64_t count = map.offsets[r + 1] - map.offsets[r];
    rows.insert(rows.end(), static_cast<std::size_t>(count), row);
    shares.insert(shares.end(), static_cast<std::size_t>(count), 1.0F / static_cast<float>(count));
  }
  const auto places = torch::stack({torch::tensor(rows, torch::kInt64), torch::tensor(map.places, torch::kInt64)});
  return torch::sparse_coo_tensor(places, torch::tensor(shares), {map.rows(), map.columns}).coalesce();
}

/// A map as places (rows K), the number of the input's places where a row has fewer, and (rows) what each place counts.
std::pair<torch::Tensor, torch::Tensor> padded(const PlaceMap& map) {
  std::int64_t most = 1;
  for (std::size_t r = 0; r + 1 < map.offsets.size(); ++r) most = std::max(most, map.offsets[r + 1] - map.offsets[r]);
  std::vector<std::int64_t> places(static_cast<std::size_t>(map.rows() * most), map.columns);
  std::vector<float> shares;
  for (std::size_t r = 0; r + 1 < map.offsets.size(); ++r) {
    const std::int64_t first = map.offsets[r], count = map.offsets[r + 1] - first;
    std::copy_n(map.places.begin() + first, count, places.begin() + static_cast<std::int64_t>(r) * most);
    shares.push_back(count > 0 ? 1.0F / static_cast<float>(count) : 0.0F);
  }
  return {torch::tensor(places, torch::kInt64), torch::tensor(shares)};
}

/// The weights of a tied layer: those of its partner, (out, inputs c, 1, 1), transposed for each of its inputs.
torch::Tensor transposed(const torch::Tensor& weight, std::int64_t inputs) {
  const std::int64_t out = weight.size(0), each = weight.size(1) / inputs;
  return weight.reshape({out, inputs, each}).permute({2, 1, 0}).reshape({each, inputs * out, 1, 1});
}

}  // namespace

torch::Tensor upsample_bilinear(const torch::Tensor& x, int factor) {
  return resize(x, x.size(2) * factor, x.size(3) * factor);
}

Network::Network(const Description& description, std::uint64_t seed) : description_(description) {
  std::uint64_t state = seed;
  std::set<std::string> known;
  for (const Layer& layer : description_.layers) {
    if (!layer.name.empty() && !known.insert(layer.name).second) continue;
    if (layer.kind == LayerKind::kMean) means_[layer.name] = sparse_mean(*layer.map);
    if (layer.kind == LayerKind::kTokens) {
      const std::int64_t out = layer.channels / layer.frames;
      const std::int64_t numbers = description_.channels(layer.inputs[0]) / layer.frames;
      parameters_.emplace_back(layer.name + "_weight", uniform({out, numbers}, 1, state));
      parameters_.emplace_back(layer.name + "_bias", uniform({out, numbers}, 1, state));
      parameters_.emplace_back(layer.name + "_time", uniform({layer.frames, out}, 1, state));
    }
    if (layer.kind == LayerKind::kNorm) {
      const std::int64_t channels = layer.channels / layer.frames;
      parameters_.emplace_back(layer.name + "_weight", torch::ones({channels}).set_requires_grad(true));
      parameters_.emplace_back(layer.name + "_bias", torch::zeros({channels}).set_requires_grad(true));
    }
    if (layer.kind != LayerKind::kConvolution) continue;
    const std::int64_t in = description_.input_channels(layer) / layer.frames, out = layer.channels / layer.frames,
                       k = layer.kernel;
    const double bound = layer.zero ? 0.0 : 1.0 / std::sqrt(static_cast<double>(in * k * k));
    if (layer.tied.empty()) parameters_.emplace_back(layer.name + "_weight", uniform({out, in, k, k}, bound, state));
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

torch::Tensor Network::convolution(const Layer& layer, const std::vector<torch::Tensor>& values,
                                   torch::ScalarType body) const {
  // No copies where the types agree already.
  const auto type = layer.exact ? torch::kFloat32 : body;
  std::vector<torch::Tensor> parts;
  for (const int index : layer.inputs) {
    parts.push_back(split_frames(values[static_cast<std::size_t>(index)].to(type), layer.frames));
  }
  const auto x = parts.size() > 1 ? torch::cat(parts, 1) : parts[0];
  const auto count = static_cast<std::int64_t>(layer.inputs.size());
  const auto weight = layer.tied.empty() ? get(layer.name + "_weight") : transposed(get(layer.tied + "_weight"), count);
  auto y = torch::conv2d(x, weight.to(type), get(layer.name + "_bias").to(type), 1, layer.kernel / 2);
  if (layer.frames > 1) y = y.reshape({-1, layer.channels, y.size(2), y.size(3)});
  if (layer.add >= 0) y = y + values[static_cast<std::size_t>(layer.add)].to(type);
  switch (layer.activation) {
    case Activation::kNone:
      return y;
    case Activation::kRelu:
      return torch::relu(y);
    case Activation::kTanh:
      return torch::tanh(y);
    case Activation::kLeakyRelu:
      return torch::leaky_relu(y, kLeak);
    case Activation::kPrelu:
      break;
  }
  const auto slope = get(layer.name + "_slope").to(type).view({1, -1, 1, 1});
  return torch::relu(y) - slope * torch::relu(-y);
}

torch::Tensor Network::mean(const torch::Tensor& x, const Layer& layer) const {
  const auto flat = x.reshape({-1, x.size(2) * x.size(3)}).t().contiguous();
  const auto means = torch::_sparse_mm(means_.at(layer.name), flat);
  return means.t().reshape({x.size(0), x.size(1), layer.size.height, layer.size.width});
}

torch::Tensor Network::layer_forward(const Layer& layer, const std::vector<torch::Tensor>& values, const Reads& reads,
                                     torch::ScalarType body) const {
  const auto value = [&](int index) { return values[static_cast<std::size_t>(index)]; };
  const auto& first = value(layer.inputs[0]);
  switch (layer.kind) {
    case LayerKind::kPixelShuffle:
      return torch::pixel_shuffle(first, layer.factor);
    case LayerKind::kUnshuffle:
      return torch::pixel_unshuffle(first, layer.factor);
    case LayerKind::kUpsample:
      return upsample_bilinear(first, layer.factor);
    case LayerKind::kPool:
      return torch::avg_pool2d(first, layer.factor, layer.factor, 0, true, false);
    case LayerKind::kResize:
      return resize(first, value(layer.like).size(2), value(layer.like).size(3));
    case LayerKind::kAttention:
      return attention(first, layer.inputs.size() > 1 ? value(layer.inputs[1]) : torch::Tensor(), layer);
    case LayerKind::kSpread:
      return spread(first, layer);
    case LayerKind::kMean:
      return mean(first, layer);
    case LayerKind::kReshape:
      return first.reshape({first.size(0), layer.channels, layer.size.height, layer.size.width});
    case LayerKind::kPart:
      return first.slice(1, layer.first, layer.first + layer.channels);
    case LayerKind::kJoin: {
      std::vector<torch::Tensor> parts;
      for (const int index : layer.inputs) parts.push_back(value(index).to(torch::kFloat32));
      return torch::cat(parts, 1);
    }
    case LayerKind::kTokens: {
      const std::int64_t channels = layer.channels / layer.frames, numbers = first.size(1) / layer.frames;
      const auto tokens = first.reshape({-1, layer.frames, 1, numbers}) * get(layer.name + "_weight") +
                          get(layer.name + "_bias") + get(layer.name + "_time").view({1, layer.frames, channels, 1});
      return tokens.reshape({-1, layer.channels, 1, numbers});
    }
    case LayerKind::kMemory:
      if (!reads.memory.defined()) throw_internal("network: it remembers something, and was not told what");
      return reads.memory;
    case LayerKind::kGiven:
      if (!reads.given.defined()) throw_internal("network: it needs a true answer");
      return reads.given;
    case LayerKind::kNorm:
      break;
    case LayerKind::kConvolution:
      return convolution(layer, values, body);
  }
  const auto type = layer.exact ? torch::kFloat32 : body;
  const auto y =
      normalized(first.to(type), layer, get(layer.name + "_weight").to(type), get(layer.name + "_bias").to(type));
  return layer.add >= 0 ? y + value(layer.add).to(type) : y;
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
  return values({x, {}, {}}, {description_.values() - 1}, body).front().to(x.scalar_type());
}

std::vector<torch::Tensor> Network::values(const Reads& reads, const std::vector<int>& wanted,
                                           torch::ScalarType body) const {
  const std::vector<bool> needed = description_.needed(wanted);
  std::vector<torch::Tensor> all{reads.x};
  for (std::size_t i = 0; i < needed.size(); ++i) {
    all.push_back(needed[i] ? layer_forward(description_.layers[i], all, reads, body) : torch::Tensor());
  }
  std::vector<torch::Tensor> result;
  for (const int value : wanted) result.push_back(all[static_cast<std::size_t>(value)]);
  return result;
}

torch::Tensor Network::no_memory(const torch::Tensor& x) const {
  const auto [channels, height, width] =
      description_.memory_shape({static_cast<int>(x.size(2)), static_cast<int>(x.size(3))});
  return torch::zeros({x.size(0), channels, height, width}, x.options());
}

torch::Tensor Network::remember(const torch::Tensor& memory, const torch::Tensor& newest) const {
  return torch::cat({memory.slice(1, newest.size(1)), newest}, 1).clamp(-kMemoryLimit, kMemoryLimit);
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

std::vector<std::size_t> Network::parameters_of(const std::vector<int>& wanted) const {
  const std::vector<bool> needed = description_.needed(wanted);
  std::set<std::string> names;
  for (std::size_t i = 0; i < needed.size(); ++i) {
    if (!needed[i]) continue;
    for (const std::string& name : {description_.layers[i].name, description_.layers[i].tied}) {
      for (const char* part : {"_weight", "_bias", "_slope", "_time"}) names.insert(name + part);
    }
  }
  std::vector<std::size_t> result;
  for (std::size_t i = 0; i < parameters_.size(); ++i) {
    if (names.count(parameters_[i].first) > 0) result.push_back(i);
  }
  return result;
}

void Network::to(torch::Device device) {
  for (auto& entry : means_) entry.second = entry.second.to(device);
  for (auto& entry : parameters_) entry.second = entry.second.detach().to(device).set_requires_grad(true);
}

std::vector<std::string> Network::float32_parameters() const {
  std::vector<std::string> names;
  for (const Layer& layer : description_.layers) {
    const bool has_parameters = layer.kind == LayerKind::kConvolution || layer.kind == LayerKind::kNorm;
    // Tokens and means have no type but float32.
    const bool float32 =
        (layer.exact && has_parameters) || layer.kind == LayerKind::kTokens || layer.kind == LayerKind::kMean;
    if (float32 && std::find(names.begin(), names.end(), layer.name + "_") == names.end()) {
      names.push_back(layer.name + "_");
    }
  }
  return names;
}

torch::jit::Module Network::to_script() const {
  const torch::NoGradGuard no_grad;
  torch::jit::Module module("PleatNetwork");
  std::vector<int> wanted{description_.values() - 1};
  if (description_.remembers()) wanted.push_back(description_.memory);
  for (const std::size_t i : parameters_of(wanted)) {
    const auto& [name, value] = parameters_[i];
    module.register_parameter(name, value.detach().to(torch::kCPU).clone(), false);
  }
  const std::vector<bool> needed = description_.needed(wanted);
  std::set<std::string> known;
  for (std::size_t i = 0; i < needed.size(); ++i) {
    const Layer& layer = description_.layers[i];
    if (!needed[i] || layer.kind != LayerKind::kMean || !known.insert(layer.name).second) continue;
    const auto [places, shares] = padded(*layer.map);
    module.register_buffer(layer.name + "_places", places);
    module.register_buffer(layer.name + "_shares", shares);
  }
  module.define(script_of(description_));
  module.eval();
  return module;
}

}  // namespace pleat::superres
