#include "services/superres/network.hpp"

#include <torch/script.h>

#include <cmath>
#include <sstream>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr int kDetailWindow = 7;
const char* const kHeads[] = {"displacement", "normal", "velocity"};

/// splitmix64: small, and the same everywhere, unlike the standard library's distributions.
std::uint64_t next_random(std::uint64_t& state) {
  state += 0x9E3779B97F4A7C15ull;
  std::uint64_t z = state;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

torch::Tensor channel_tensor(const std::vector<float>& values) {
  return torch::tensor(values, torch::kFloat32).view({1, kChannels, 1, 1});
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

Network::Network(const Architecture& architecture, std::uint64_t seed)
    : architecture_(architecture), random_state_(seed) {
  validate(architecture);
  const Architecture& a = architecture_;
  const bool subpixel = a.upsampling == "subpixel";
  add_convolution("shallow0", a.conditioned ? 2 * kChannels : kChannels, a.features, 3, false);
  add_convolution("shallow1", a.features, a.features, 3, false);
  for (int d = 0; d < a.blocks; ++d) {
    for (int c = 0; c < a.layers; ++c) {
      add_convolution(dense_name(d, c), a.features + c * a.growth, a.growth, 3, false);
    }
    add_convolution(fusion_name(d), a.features + a.layers * a.growth, a.features, 1, false);
  }
  add_convolution("global0", a.blocks * a.features, a.features, 1, false);
  add_convolution("global1", a.features, a.features, 3, false);
  for (const char* head : kHeads) {
    add_convolution(std::string("head_") + head, a.features, subpixel ? 3 * kScale * kScale : 3, 3, a.residual);
  }
  if (a.conditioned) {
    for (const char* name : {"input_mean", "input_deviation", "detail_deviation", "output_deviation"}) {
      const bool mean = std::string(name) == "input_mean";
      buffers_.emplace_back(name, torch::full({1, kChannels, 1, 1}, mean ? 0.5 : 1.0));
    }
  }
}

void Network::add_convolution(const std::string& name, int in, int out, int kernel, bool zero) {
  const double bound = zero ? 0.0 : 1.0 / std::sqrt(static_cast<double>(in) * kernel * kernel);
  auto weight = torch::empty({out, in, kernel, kernel});
  auto bias = torch::empty({out});
  for (const torch::Tensor& tensor : {weight, bias}) {
    float* values = tensor.data_ptr<float>();
    for (std::int64_t i = 0; i < tensor.numel(); ++i) {
      const double uniform = static_cast<double>(next_random(random_state_) >> 11) * 0x1.0p-53;
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
      {"output_deviation", &conditioning.output_deviation}};
  for (std::size_t i = 0; i < 4; ++i) {
    const auto& [name, values] = sets[i];
    bool good = values->size() == kChannels;
    for (const float v : *values) good = good && std::isfinite(v) && (i == 0 || v > 0);
    if (!good)
      throw_invalid_argument(std::string("conditioning: ") + name + " needs nine finite values, deviations > 0");
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

torch::Tensor Network::forward(const torch::Tensor& x, torch::ScalarType body) const {
  const Architecture& a = architecture_;
  torch::Tensor input = x;
  if (a.conditioned) {
    input =
        torch::cat({(x - get("input_mean")) / get("input_deviation"), local_detail(x) / get("detail_deviation")}, 1);
  }
  const auto shallow = convolve(input, "shallow0", 3);
  auto features = convolve(shallow, "shallow1", 3).to(body);
  std::vector<torch::Tensor> hierarchy;
  for (int d = 0; d < a.blocks; ++d) {
    std::vector<torch::Tensor> dense{features};
    for (int c = 0; c < a.layers; ++c) {
      dense.push_back(torch::relu(convolve(torch::cat(dense, 1), dense_name(d, c), 3)));
    }
    features = convolve(torch::cat(dense, 1), fusion_name(d), 1) + features;
    hierarchy.push_back(features);
  }
  features = convolve(convolve(torch::cat(hierarchy, 1), "global0", 1), "global1", 3) + shallow.to(body);
  const bool subpixel = a.upsampling == "subpixel";
  if (!subpixel) features = upsample_bilinear(features);
  std::vector<torch::Tensor> heads;
  for (const char* head : kHeads) heads.push_back(convolve(features, std::string("head_") + head, 3));
  auto output = torch::cat(heads, 1).to(x.scalar_type());
  if (subpixel) output = torch::pixel_shuffle(output, kScale);
  if (a.conditioned) output = output * get("output_deviation");
  if (a.residual) output = output + upsample_bilinear(x);
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
    for (auto& entry : *list) entry.second = entry.second.detach().to(device).set_requires_grad(list == &parameters_);
  }
}

std::vector<std::string> Network::float32_parameters() { return {"shallow", "input_", "detail_", "output_"}; }

std::string Network::script_source() const {
  const Architecture& a = architecture_;
  std::ostringstream out;
  const auto convolution = [](const std::string& x, const std::string& name, int kernel) {
    const std::string p = std::to_string(kernel / 2);
    return "torch.conv2d(" + x + ", self." + name + "_weight, self." + name + "_bias, [1, 1], [" + p + ", " + p + "])";
  };
  const std::string size = "[x.size(2) * 4, x.size(3) * 4]";
  out << "def forward(self, x):\n";
  if (a.conditioned) {
    out << "  d = x - torch.avg_pool2d(x, [7, 7], [1, 1], [3, 3], False, False)\n"
        << "  i = torch.cat([(x - self.input_mean) / self.input_deviation, d / self.detail_deviation], 1)\n";
  } else {
    out << "  i = x\n";
  }
  // The type of the body is that of its weights, so one module serves float32 and bfloat16.
  out << "  s = " << convolution("i", "shallow0", 3) << "\n";
  out << "  f = " << convolution("s", "shallow1", 3) << ".to(self.global1_weight.dtype)\n";
  std::string hierarchy;
  for (int d = 0; d < a.blocks; ++d) {
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
  out << "  g = " << convolution("torch.cat([" + hierarchy + "], 1)", "global0", 1) << "\n";
  out << "  g = " << convolution("g", "global1", 3) << " + s.to(self.global1_weight.dtype)\n";
  if (a.upsampling == "subpixel") {
    out << "  y = torch.pixel_shuffle(" << convolution("g", "heads", 3) << ".to(x.dtype), 4)\n";
  } else {
    out << "  g = torch.upsample_bilinear2d(g, " << size << ", False)\n";
    out << "  y = " << convolution("g", "heads", 3) << ".to(x.dtype)\n";
  }
  if (a.conditioned) out << "  y = y * self.output_deviation\n";
  if (a.residual) out << "  y = y + torch.upsample_bilinear2d(x, " << size << ", False)\n";
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
  for (const char* part : {"_weight", "_bias"}) {
    std::vector<torch::Tensor> heads;
    for (const char* head : kHeads) heads.push_back(copy(get(std::string("head_") + head + part)));
    module.register_parameter(std::string("heads") + part, torch::cat(heads, 0), false);
  }
  for (const auto& [name, value] : buffers_) module.register_buffer(name, copy(value));
  module.define(script_source());
  module.eval();
  return module;
}

}  // namespace pleat::superres
