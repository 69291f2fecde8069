#include "services/superres/network.hpp"

#include <torch/script.h>

#include <cmath>
#include <sstream>

#include "common/base/error.hpp"
#include "common/base/random.hpp"
#include "services/superres/cpu/kernels.hpp"

namespace pleat::superres {
namespace {

constexpr int kDetailWindow = 7;
constexpr double kLargestFeature = 6;
const char* const kHeads[] = {"displacement", "normal", "velocity"};

/// local_frame() in TorchScript: leaves the axes in t, s2, n and the network's input in i.
constexpr const char* kLocalScript = R"(
  p = x * self.base_range + self.base_minimum
  k = torch.cat([p[:, 0:3] + self.base_rest, self.base_rest], 0)
  k = torch.cat([2 * k[:, :, 0:1] - k[:, :, 1:2], k, 2 * k[:, :, -1:] - k[:, :, -2:-1]], 2)
  k = torch.cat([2 * k[:, :, :, 0:1] - k[:, :, :, 1:2], k, 2 * k[:, :, :, -1:] - k[:, :, :, -2:-1]], 3)
  du = (k[:, :, 1:-1, 2:] - k[:, :, 1:-1, :-2]) / 2
  dv = (k[:, :, 2:, 1:-1] - k[:, :, :-2, 1:-1]) / 2
  duu = (k[:, :, 1:-1, 2:] - 2 * k[:, :, 1:-1, 1:-1] + k[:, :, 1:-1, :-2])[:-1]
  duv = ((k[:, :, 2:, 2:] - k[:, :, 2:, :-2] - k[:, :, :-2, 2:] + k[:, :, :-2, :-2]) / 4)[:-1]
  dvv = (k[:, :, 2:, 1:-1] - 2 * k[:, :, 1:-1, 1:-1] + k[:, :, :-2, 1:-1])[:-1]
  ru = torch.sum(du[-1:] * du[-1:], [1], True)
  rv = torch.sum(dv[-1:] * dv[-1:], [1], True)
  du = du[:-1]
  dv = dv[:-1]
  n = torch.cross(du, dv, 1)
  n = n / torch.sqrt(torch.sum(n * n, [1], True)).clamp_min(1e-9)
  t = du / torch.sqrt(torch.sum(du * du, [1], True)).clamp_min(1e-9)
  s2 = torch.cross(n, t, 1)
  q = [torch.sum(du * du, [1], True) / ru - 1, torch.sum(dv * dv, [1], True) / rv - 1, torch.sum(du * dv, [1], True) / torch.sqrt(ru * rv)]
  for b in [duu, duv, dvv]:
    for c in [t, s2, n]:
      q.append(torch.sum(b * c, [1], True))
  for c in [t, s2]:
    q.append(torch.sum(p[:, 3:6] * c, [1], True))
  for c in [t, s2, n]:
    q.append(torch.sum(p[:, 6:9] * c, [1], True))
  i = ((torch.cat(q, 1) - self.local_mean) / self.local_deviation).clamp(-6.0, 6.0)
)";

torch::Tensor channel_tensor(const std::vector<float>& values) {
  return torch::tensor(values, torch::kFloat32).view({1, -1, 1, 1});
}

std::string dense_name(int block, int layer) {
  return "block" + std::to_string(block) + "_dense" + std::to_string(layer);
}

std::string fusion_name(int block) { return "block" + std::to_string(block) + "_fusion"; }

}  // namespace

torch::Tensor upsample_bilinear(const torch::Tensor& x) {
  return torch::upsample_bilinear2d(x, {x.size(2) * kScale, x.size(3) * kScale}, false);
}

torch::Tensor local_detail(const torch::Tensor& x) {
  return x - torch::avg_pool2d(x, kDetailWindow, 1, kDetailWindow / 2, false, false);
}

namespace {

/// One texel more on each side, continued linearly, so that differences at the border are one-sided.
torch::Tensor extend(const torch::Tensor& p) {
  const auto h = p.size(2), w = p.size(3);
  const auto rows =
      torch::cat({2 * p.slice(2, 0, 1) - p.slice(2, 1, 2), p, 2 * p.slice(2, h - 1, h) - p.slice(2, h - 2, h - 1)}, 2);
  return torch::cat(
      {2 * rows.slice(3, 0, 1) - rows.slice(3, 1, 2), rows, 2 * rows.slice(3, w - 1, w) - rows.slice(3, w - 2, w - 1)},
      3);
}

struct Differences {
  torch::Tensor u, v, uu, uv, vv;
};

Differences differences(const torch::Tensor& p) {
  const auto h = p.size(2), w = p.size(3);
  const auto q = extend(p);
  const auto at = [&](int dy, int dx) { return q.slice(2, 1 + dy, 1 + dy + h).slice(3, 1 + dx, 1 + dx + w); };
  return {(at(0, 1) - at(0, -1)) / 2, (at(1, 0) - at(-1, 0)) / 2, at(0, 1) - 2 * p + at(0, -1),
          (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4, at(1, 0) - 2 * p + at(-1, 0)};
}

torch::Tensor contract(const torch::Tensor& a, const torch::Tensor& b) { return (a * b).sum(1, true); }

torch::Tensor unit(const torch::Tensor& a) { return a / contract(a, a).sqrt().clamp_min(1e-9); }

}  // namespace

LocalFrame local_frame(const torch::Tensor& x, const torch::Tensor& minimum, const torch::Tensor& range,
                       const torch::Tensor& rest) {
  const auto physical = x * range + minimum;
  const auto d = differences(physical.slice(1, 0, 3) + rest), r = differences(rest);
  const auto normal = unit(torch::cross(d.u, d.v, 1)), first = unit(d.u);
  const auto second = torch::cross(normal, first, 1);
  std::vector<torch::Tensor> features{contract(d.u, d.u) / contract(r.u, r.u) - 1,
                                      contract(d.v, d.v) / contract(r.v, r.v) - 1,
                                      contract(d.u, d.v) / (contract(r.u, r.u) * contract(r.v, r.v)).sqrt()};
  for (const auto& bend : {d.uu, d.uv, d.vv}) {
    for (const auto& axis : {first, second, normal}) features.push_back(contract(bend, axis));
  }
  for (const auto& axis : {first, second}) features.push_back(contract(physical.slice(1, 3, 6), axis));
  for (const auto& axis : {first, second, normal}) features.push_back(contract(physical.slice(1, 6, 9), axis));
  return {torch::cat({first, second, normal}, 1), torch::cat(features, 1)};
}

torch::Tensor from_local(const torch::Tensor& y, const torch::Tensor& axes) {
  std::vector<torch::Tensor> vectors;
  for (int g = 0; g < 9; g += 3) {
    vectors.push_back(y.slice(1, g, g + 1) * axes.slice(1, 0, 3) + y.slice(1, g + 1, g + 2) * axes.slice(1, 3, 6) +
                      y.slice(1, g + 2, g + 3) * axes.slice(1, 6, 9));
  }
  return torch::cat(vectors, 1);
}

torch::Tensor to_local(const torch::Tensor& y, const torch::Tensor& axes) {
  std::vector<torch::Tensor> values;
  for (int g = 0; g < 9; g += 3) {
    for (int a = 0; a < 9; a += 3) values.push_back(contract(y.slice(1, g, g + 3), axes.slice(1, a, a + 3)));
  }
  return torch::cat(values, 1);
}

Network::Network(const Architecture& architecture, std::uint64_t seed)
    : architecture_(architecture), random_state_(seed) {
  validate(architecture);
  const Architecture& a = architecture_;
  if (a.kind == "chen2018") {
    add_convolution("shallow0", 3, a.features, 3, false);
    add_slope("shallow0");
    add_residual_blocks();
    add_convolution("global1", a.features, a.features, 3, false);
    for (const char* stage : {"stage0", "stage1"}) {
      add_convolution(stage, a.features, 4 * a.features, 3, false);
      add_slope(stage);
    }
    add_convolution("last", a.features, 3, 3, false);
    return;
  }
  const bool subpixel = a.upsampling == "subpixel";
  add_convolution("shallow0",
                  (a.axes == "local" ? kLocalChannels
                   : a.conditioned   ? 2 * kChannels
                                     : kChannels) +
                      (a.residual == "mesh" ? kStructureChannels : 0),
                  a.features, 3, false);
  add_convolution("shallow1", a.features, a.features, 3, false);
  if (a.kind == "srresnet") {
    add_residual_blocks();
  } else {
    for (int d = 0; d < a.blocks; ++d) {
      for (int c = 0; c < a.layers; ++c) {
        add_convolution(dense_name(d, c), a.features + c * a.growth, a.growth, 3, false);
      }
      add_convolution(fusion_name(d), a.features + a.layers * a.growth, a.features, 1, false);
    }
    add_convolution("global0", a.blocks * a.features, a.features, 1, false);
  }
  add_convolution("global1", a.features, a.features, 3, false);
  for (const char* head : kHeads) {
    add_convolution(std::string("head_") + head, a.features, subpixel ? 3 * kScale * kScale : 3, 3,
                    a.residual != "none");
  }
  if (a.conditioned) {
    for (const char* name : {"input_mean", "input_deviation", "detail_deviation", "output_deviation"}) {
      const bool mean = std::string(name) == "input_mean";
      buffers_.emplace_back(name, torch::full({1, kChannels, 1, 1}, mean ? 0.5 : 1.0));
    }
    buffers_.emplace_back("local_mean", torch::zeros({1, kLocalChannels, 1, 1}));
    buffers_.emplace_back("local_deviation", torch::ones({1, kLocalChannels, 1, 1}));
    buffers_.emplace_back("local_output", torch::ones({1, kChannels, 1, 1}));
  }
}

void Network::add_slope(const std::string& name) {
  parameters_.emplace_back(name + "_slope", torch::full({architecture_.features}, 0.25).set_requires_grad(true));
}

void Network::add_residual_blocks() {
  const int f = architecture_.features;
  for (int d = 0; d < architecture_.blocks; ++d) {
    const std::string block = "block" + std::to_string(d);
    add_convolution(block + "_first", f, f, 3, false);
    add_convolution(block + "_second", f, f, 3, false);
  }
}

void Network::add_convolution(const std::string& name, int in, int out, int kernel, bool zero) {
  const double bound = zero ? 0.0 : 1.0 / std::sqrt(static_cast<double>(in) * kernel * kernel);
  auto weight = torch::empty({out, in, kernel, kernel});
  auto bias = torch::empty({out});
  for (const torch::Tensor& tensor : {weight, bias}) {
    float* values = tensor.data_ptr<float>();
    for (std::int64_t i = 0; i < tensor.numel(); ++i) {
      const double uniform = unit_interval(split_mix(random_state_));
      values[i] = static_cast<float>(bound * (2 * uniform - 1));
    }
  }
  parameters_.emplace_back(name + "_weight", weight.set_requires_grad(true));
  parameters_.emplace_back(name + "_bias", bias.set_requires_grad(true));
}

void Network::set_conditioning(const Conditioning& conditioning) {
  if (!architecture_.conditioned) return;
  const std::pair<const char*, const std::vector<float>*> sets[] = {
      {"input_mean", &conditioning.input_mean},
      {"input_deviation", &conditioning.input_deviation},
      {"detail_deviation", &conditioning.detail_deviation},
      {"output_deviation", &conditioning.output_deviation},
      {"local_mean", &conditioning.local_mean},
      {"local_deviation", &conditioning.local_deviation},
      {"local_output", &conditioning.local_output}};
  for (std::size_t i = 0; i < (architecture_.axes == "local" ? 7U : 4U); ++i) {
    const auto& [name, values] = sets[i];
    const bool mean = i == 0 || i == 4;
    bool good = values->size() == static_cast<std::size_t>(buffers_[i].second.numel());
    for (const float v : *values) good = good && std::isfinite(v) && (mean || v > 0);
    if (!good)
      throw_invalid_argument(std::string("conditioning: ") + name +
                             " needs finite values, one a channel, deviations > 0");
    buffers_[i].second = channel_tensor(*values).to(buffers_[i].second.device());
  }
}

const torch::Tensor& Network::get(const std::string& name) const {
  for (const auto* list : {&parameters_, &buffers_}) {
    for (const auto& [key, value] : *list) {
      if (key == name) return value;
    }
  }
  throw_internal("network: no parameter " + name);
}

torch::Tensor Network::convolve(const torch::Tensor& x, const std::string& name, int kernel) const {
  // No copy where the types agree already.
  const auto type = x.scalar_type();
  return torch::conv2d(x, get(name + "_weight").to(type), get(name + "_bias").to(type), 1, kernel / 2);
}

void Network::set_mesh_base(const MeshBase& base, const Normalization& normalization, int height, int width) {
  if (!needs_mesh(architecture_)) return;
  const std::int64_t texels = static_cast<std::int64_t>(height) * width, fine = texels * kScale * kScale;
  const std::int64_t near =
      base.vertices > 0 ? static_cast<std::int64_t>(base.vertex_texels.size()) / base.vertices : 0;
  if (near < 1 || static_cast<std::int64_t>(base.vertex_texels.size()) != base.vertices * near ||
      base.vertex_weights.size() != base.vertex_texels.size() ||
      static_cast<std::int64_t>(base.corners.size()) != 3 * fine || base.weights.size() != base.corners.size() ||
      static_cast<std::int64_t>(base.rest.size()) != 3 * texels ||
      static_cast<std::int64_t>(base.structure.size()) != kStructureChannels * texels) {
    throw_internal("mesh base: sizes contradict each other");
  }
  const auto device = parameters_.front().second.device();
  std::vector<float> minimum(kChannels), range(kChannels);
  for (std::size_t c = 0; c < kChannels; ++c) {
    minimum[c] = normalization.minimum[c];
    range[c] = normalization.maximum[c] - minimum[c];
  }
  const std::pair<std::string, torch::Tensor> values[] = {
      {"base_minimum", channel_tensor(minimum)},
      {"base_range", channel_tensor(range)},
      {"base_rest", torch::tensor(base.rest).view({1, 3, height, width})},
      {"base_vertex_texels", torch::tensor(base.vertex_texels).view({base.vertices, near})},
      {"base_vertex_weights", torch::tensor(base.vertex_weights).view({base.vertices, near})},
      {"base_corners", torch::tensor(base.corners).view({3, fine})},
      {"base_weights", torch::tensor(base.weights).view({3, fine})},
      {"base_structure", torch::tensor(base.structure).view({1, kStructureChannels, height, width})}};
  for (const auto& [name, value] : values) {
    std::erase_if(buffers_, [&key = name](const auto& entry) { return entry.first == key; });
    buffers_.emplace_back(name, value.to(device));
  }
}

torch::Tensor Network::base_image(const torch::Tensor& x) const {
  // Around the middle of the range, so that a fit that is not exact stays harmless.
  const auto& texels = get("base_vertex_texels");
  const auto near = (x.flatten(2) - 0.5).index_select(2, texels.flatten());
  const auto vertices =
      (near.view({x.size(0), x.size(1), texels.size(0), texels.size(1)}) * get("base_vertex_weights")).sum(3);
  const auto &corners = get("base_corners"), &weights = get("base_weights");
  auto image = torch::full({1}, 0.5, x.options());
  for (int k = 0; k < 3; ++k) image = image + vertices.index_select(2, corners[k]) * weights[k];
  return image.view({x.size(0), x.size(1), x.size(2) * kScale, x.size(3) * kScale});
}

torch::Tensor Network::prelu(const torch::Tensor& x, const std::string& name) const {
  const auto slope = get(name + "_slope").to(x.scalar_type()).view({1, -1, 1, 1});
  return torch::relu(x) - slope * torch::relu(-x);
}

torch::Tensor Network::residual_blocks(torch::Tensor features) const {
  for (int d = 0; d < architecture_.blocks; ++d) {
    const std::string block = "block" + std::to_string(d);
    features = convolve(torch::relu(convolve(features, block + "_first", 3)), block + "_second", 3) + features;
  }
  return features;
}

torch::Tensor Network::chen_forward(const torch::Tensor& x, torch::ScalarType body) const {
  const auto minimum = get("base_minimum").slice(1, 0, 3), range = get("base_range").slice(1, 0, 3);
  const auto& rest = get("base_rest");
  const auto unit = range.mean();
  const auto positions = (x.slice(1, 0, 3) * range + minimum + rest) / unit;
  const auto shallow = prelu(convolve(positions, "shallow0", 3), "shallow0").to(body);
  auto features = convolve(residual_blocks(shallow), "global1", 3) + shallow;
  for (const char* stage : {"stage0", "stage1"}) {
    features = prelu(torch::pixel_shuffle(convolve(features, stage, 3), 2), stage);
  }
  const auto answer = convolve(features, "last", 3).to(x.scalar_type()) * unit;
  return torch::cat({(answer - base_image(rest) - minimum) / range, upsample_bilinear(x.slice(1, 3, kChannels))}, 1);
}

torch::Tensor Network::forward(const torch::Tensor& x, torch::ScalarType body) const {
  if (architecture_.kind == "chen2018") return chen_forward(x, body);
  if (architecture_.residual == "mesh") return forward(x, base_image(x), get("base_structure"), body);
  const auto output = body_forward(x, {}, body);
  return architecture_.residual == "bilinear" ? output + upsample_bilinear(x) : output;
}

torch::Tensor Network::forward(const torch::Tensor& x, const torch::Tensor& base, const torch::Tensor& structure,
                               torch::ScalarType body) const {
  return body_forward(x, structure, body) + base;
}

namespace {

/// The own kernels as a function that autograd knows. Activations stay in the Trainable.
struct OwnConvolutions : torch::autograd::Function<OwnConvolutions> {
  static torch::Tensor forward(torch::autograd::AutogradContext* context, const torch::Tensor& input,
                               at::TensorList parameters, const Network* network, bool keep) {
    cpu::Trainable& trainable = *network->trainable();
    trainable.load([&](const std::string& name) { return cpu::Parameter{find(*network, parameters, name), nullptr}; });
    auto output = torch::empty({input.size(0), trainable.outputs(), input.size(2), input.size(3)});
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
    network->trainable()->backward(gradients[0].contiguous().data_ptr<float>(), [&](const std::string& name) {
      return cpu::Parameter{nullptr, find(*network, own, name)};
    });
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

void Network::use_own_kernels(int threads) {
  own_threads_ = threads;
  trainable_.reset();
}

torch::Tensor Network::own_convolutions(const torch::Tensor& input, torch::ScalarType body) const {
  const bool bfloat16 = body == torch::kBFloat16;
  const int height = static_cast<int>(input.size(2)), width = static_cast<int>(input.size(3));
  const auto fits = [&](const cpu::TrainableOptions& o) {
    return o.height == height && o.width == width && o.bfloat16 == bfloat16;
  };
  if (!trainable_ || !fits(trainable_->options())) {
    trainable_ = std::make_shared<cpu::Trainable>(
        architecture_, cpu::TrainableOptions{static_cast<int>(input.size(1)), height, width, bfloat16, own_threads_});
  }
  const auto values = parameter_values();
  auto features = OwnConvolutions::apply(input, at::TensorList(values), this, torch::GradMode::is_enabled());
  if (architecture_.upsampling == "subpixel") return features;
  features = upsample_bilinear(features.to(body));
  std::vector<torch::Tensor> heads;
  for (const char* head : kHeads) heads.push_back(convolve(features, std::string("head_") + head, 3));
  return torch::cat(heads, 1).to(input.scalar_type());
}

torch::Tensor Network::convolutions(const torch::Tensor& input, torch::ScalarType body) const {
  const Architecture& a = architecture_;
  const auto shallow = convolve(input, "shallow0", 3);
  auto features = convolve(shallow, "shallow1", 3).to(body);
  if (a.kind == "srresnet") {
    features = residual_blocks(features);
  } else {
    std::vector<torch::Tensor> hierarchy;
    for (int d = 0; d < a.blocks; ++d) {
      std::vector<torch::Tensor> dense{features};
      for (int c = 0; c < a.layers; ++c) {
        dense.push_back(torch::relu(convolve(torch::cat(dense, 1), dense_name(d, c), 3)));
      }
      features = convolve(torch::cat(dense, 1), fusion_name(d), 1) + features;
      hierarchy.push_back(features);
    }
    features = convolve(torch::cat(hierarchy, 1), "global0", 1);
  }
  features = convolve(features, "global1", 3) + shallow.to(body);
  if (a.upsampling != "subpixel") features = upsample_bilinear(features);
  std::vector<torch::Tensor> heads;
  for (const char* head : kHeads) heads.push_back(convolve(features, std::string("head_") + head, 3));
  return torch::cat(heads, 1).to(input.scalar_type());
}

torch::Tensor Network::body_forward(const torch::Tensor& x, const torch::Tensor& structure,
                                    torch::ScalarType body) const {
  const Architecture& a = architecture_;
  torch::Tensor input = x, axes;
  if (a.axes == "local") {
    const auto local = local_frame(x, get("base_minimum"), get("base_range"), get("base_rest"));
    axes = local.axes;
    // Folds have curvatures far beyond the deviation.
    input = ((local.features - get("local_mean")) / get("local_deviation")).clamp(-kLargestFeature, kLargestFeature);
  } else if (a.conditioned) {
    input =
        torch::cat({(x - get("input_mean")) / get("input_deviation"), local_detail(x) / get("detail_deviation")}, 1);
  }
  if (structure.defined()) input = torch::cat({input, structure.expand({x.size(0), -1, -1, -1})}, 1);
  const bool own = own_threads_ > 0 && input.device().is_cpu() && cpu::Trainable::supports(a) &&
                   (body == torch::kFloat32 || cpu::has_bfloat16());
  auto output = own ? own_convolutions(input, body) : convolutions(input, body);
  if (a.upsampling == "subpixel") output = torch::pixel_shuffle(output, kScale);
  if (a.axes == "local") {
    output = from_local(output * get("local_output"), upsample_bilinear(axes)) / get("base_range");
  } else if (a.conditioned) {
    output = output * get("output_deviation");
  }
  return output;
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
  for (auto* list : {&parameters_, &buffers_}) {
    for (auto& entry : *list) {
      entry.second = entry.second.detach().to(device);
      if (list == &parameters_) entry.second.set_requires_grad(true);
    }
  }
}

std::vector<std::string> Network::float32_parameters() {
  return {"shallow", "input_", "detail_", "output_", "base_", "local_"};
}

namespace {

// Parts of TorchScript.
std::string convolution(const std::string& x, const std::string& name, int kernel) {
  const std::string p = std::to_string(kernel / 2);
  return "torch.conv2d(" + x + ", self." + name + "_weight, self." + name + "_bias, [1, 1], [" + p + ", " + p + "])";
}

std::string prelu_of(const std::string& x, const std::string& name) {
  return "  " + x + " = torch.relu(" + x + ") - self." + name + "_slope.view([1, -1, 1, 1]) * torch.relu(-" + x + ")\n";
}

/// Residual blocks on f.
std::string residual_script(int blocks) {
  std::string out;
  for (int d = 0; d < blocks; ++d) {
    const std::string block = "block" + std::to_string(d);
    out += "  a = torch.relu(" + convolution("f", block + "_first", 3) + ")\n";
    out += "  f = " + convolution("a", block + "_second", 3) + " + f\n";
  }
  return out;
}

/// Adds the upsampled mesh of the image `x` to `z`, an image in rows, where 0.5 is added already.
std::string mesh_script(const std::string& x, const std::string& z) {
  std::string out = "  v = torch.index_select(" + x + ".flatten(2) - 0.5, 2, self.base_vertex_texels.flatten())\n" +
                    "  v = torch.sum(v.view([" + x + ".size(0), " + x +
                    ".size(1), self.base_vertex_texels.size(0), self.base_vertex_texels.size(1)]) * "
                    "self.base_vertex_weights, [3])\n";
  for (const char* k : {"0", "1", "2"}) {
    out += "  " + z + " = " + z + " + torch.index_select(v, 2, self.base_corners[" + k + "]) * self.base_weights[" + k +
           "]\n";
  }
  return out;
}

const char* const kFineSize = "[x.size(2) * 4, x.size(3) * 4]";

}  // namespace

std::string Network::chen_script() const {
  std::string out =
      "def forward(self, x):\n"
      "  m = self.base_minimum[:, 0:3]\n"
      "  r = self.base_range[:, 0:3]\n"
      "  p = (x[:, 0:3] * r + m + self.base_rest) / torch.mean(r)\n";
  out += "  s = " + convolution("p", "shallow0", 3) + "\n" + prelu_of("s", "shallow0");
  out += "  s = s.to(self.global1_weight.dtype)\n  f = s\n" + residual_script(architecture_.blocks);
  out += "  f = " + convolution("f", "global1", 3) + " + s\n";
  for (const std::string stage : {"stage0", "stage1"}) {
    out += "  f = torch.pixel_shuffle(" + convolution("f", stage, 3) + ", 2)\n" + prelu_of("f", stage);
  }
  out += "  y = " + convolution("f", "last", 3) +
         ".to(x.dtype) * torch.mean(r)\n  z = torch.zeros_like(y).flatten(2) + 0.5\n";
  out += mesh_script("self.base_rest", "z");
  out += "  y = (y - z.view_as(y) - m) / r\n  return torch.cat([y, torch.upsample_bilinear2d(x[:, 3:9], ";
  return out + kFineSize + ", False)], 1)\n";
}

std::string Network::script_source() const {
  const Architecture& a = architecture_;
  if (a.kind == "chen2018") return chen_script();
  std::ostringstream out;
  out << "def forward(self, x):\n";
  if (a.axes == "local") {
    out << kLocalScript;
  } else if (a.conditioned) {
    out << "  d = x - torch.avg_pool2d(x, [7, 7], [1, 1], [3, 3], False, False)\n"
        << "  i = torch.cat([(x - self.input_mean) / self.input_deviation, d / self.detail_deviation], 1)\n";
  } else {
    out << "  i = x\n";
  }
  if (a.residual == "mesh") out << "  i = torch.cat([i, self.base_structure.expand([x.size(0), -1, -1, -1])], 1)\n";
  // The type of the body is that of its weights, so one module serves float32 and bfloat16.
  out << "  s = " << convolution("i", "shallow0", 3) << "\n";
  out << "  f = " << convolution("s", "shallow1", 3) << ".to(self.global1_weight.dtype)\n";
  if (a.kind == "srresnet") out << residual_script(a.blocks) << "  g = f\n";
  std::string hierarchy;
  for (int d = 0; a.kind == "mfsr" && d < a.blocks; ++d) {
    std::string dense = "f";
    for (int c = 0; c < a.layers; ++c) {
      const std::string input = c == 0 ? "f" : "torch.cat([" + dense + "], 1)";
      out << "  a" << c << " = torch.relu(" << convolution(input, dense_name(d, c), 3) << ")\n";
      dense += ", a" + std::to_string(c);
    }
    out << "  f = " << convolution("torch.cat([" + dense + "], 1)", fusion_name(d), 1) << " + f\n";
    out << "  b" << d << " = f\n";
    hierarchy += (d == 0 ? "b" : ", b") + std::to_string(d);
  }
  if (a.kind == "mfsr") {
    out << "  g = " << convolution("torch.cat([" + hierarchy + "], 1)", "global0", 1) << "\n";
  }
  out << "  g = " << convolution("g", "global1", 3) << " + s.to(self.global1_weight.dtype)\n";
  if (a.upsampling == "subpixel") {
    out << "  y = torch.pixel_shuffle(" << convolution("g", "heads", 3) << ".to(x.dtype), 4)\n";
  } else {
    out << "  g = torch.upsample_bilinear2d(g, " << kFineSize << ", False)\n";
    out << "  y = " << convolution("g", "heads", 3) << ".to(x.dtype)\n";
  }
  if (a.axes == "local") {
    out << "  y = y * self.local_output\n  e = torch.upsample_bilinear2d(torch.cat([t, s2, n], 1), " << kFineSize
        << ", False)\n"
        << "  y = torch.cat([";
    for (int g = 0; g < kChannels; g += 3) {
      out << (g > 0 ? ", " : "");
      for (int k = 0; k < 3; ++k) {
        out << (k > 0 ? " + " : "") << "y[:, " << g + k << ":" << g + k + 1 << "] * e[:, " << 3 * k << ":" << 3 * k + 3
            << "]";
      }
    }
    out << "], 1) / self.base_range\n";
  } else if (a.conditioned) {
    out << "  y = y * self.output_deviation\n";
  }
  if (a.residual == "bilinear") out << "  y = y + torch.upsample_bilinear2d(x, " << kFineSize << ", False)\n";
  if (a.residual == "mesh") {
    out << "  z = y.flatten(2) + 0.5\n"
        << mesh_script("x", "z") << "  y = z.view([x.size(0), x.size(1), x.size(2) * 4, x.size(3) * 4])\n";
  }
  out << "  return y\n";
  return out.str();
}

torch::jit::Module Network::to_script() const {
  torch::NoGradGuard no_grad;
  torch::jit::Module module("PleatMfsr");
  const auto copy = [](const torch::Tensor& t) { return t.detach().to(torch::kCPU).clone(); };
  for (const auto& [name, value] : parameters_) {
    if (name.rfind("head_", 0) != 0) module.register_parameter(name, copy(value), false);
  }
  const bool has_heads = architecture_.kind != "chen2018";
  for (const std::string part : {"_weight", "_bias"}) {
    if (!has_heads) break;
    std::vector<torch::Tensor> heads;
    for (const char* head : kHeads) heads.push_back(copy(get(std::string("head_") + head + part)));
    module.register_parameter("heads" + part, torch::cat(heads, 0), false);
  }
  for (const auto& [name, value] : buffers_) module.register_buffer(name, copy(value));
  module.define(script_source());
  module.eval();
  return module;
}

}  // namespace pleat::superres
