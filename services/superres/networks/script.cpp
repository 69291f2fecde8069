#include "services/superres/networks/script.hpp"

namespace pleat::superres {
namespace {

std::string value_name(int value) { return value == 0 ? "x" : "v" + std::to_string(value); }

/// Layers that have no type of their own keep that of their input.
bool is_exact(const Description& network, int value) {
  if (value == 0) return true;
  const Layer& layer = network.layers[static_cast<std::size_t>(value) - 1];
  return layer.kind == LayerKind::kConvolution ? layer.exact : is_exact(network, layer.inputs[0]);
}

std::string in_type_of(const Description& network, const Layer& layer, int value) {
  const std::string name = value_name(value);
  return is_exact(network, value) == layer.exact ? name : name + ".to(self." + layer.name + "_weight.dtype)";
}

std::string convolution(const Description& network, const Layer& layer) {
  std::string input;
  for (const int value : layer.inputs) input += (input.empty() ? "" : ", ") + in_type_of(network, layer, value);
  if (layer.inputs.size() > 1) input = "torch.cat([" + input + "], 1)";
  const std::string pad = std::to_string(layer.kernel / 2), self = "self." + layer.name;
  std::string result =
      "torch.conv2d(" + input + ", " + self + "_weight, " + self + "_bias, [1, 1], [" + pad + ", " + pad + "])";
  if (layer.add >= 0) result += " + " + in_type_of(network, layer, layer.add);
  return layer.activation == Activation::kRelu ? "torch.relu(" + result + ")" : result;
}

std::string bilinear(const std::string& input, const std::string& height, const std::string& width) {
  return "torch.upsample_bilinear2d(" + input + ", [" + height + ", " + width + "], False)";
}

std::string line(const Description& network, const Layer& layer) {
  const std::string input = value_name(layer.inputs[0]), f = std::to_string(layer.factor);
  switch (layer.kind) {
    case LayerKind::kConvolution:
      return convolution(network, layer);
    case LayerKind::kPixelShuffle:
      return "torch.pixel_shuffle(" + input + ", " + f + ")";
    case LayerKind::kUpsample:
      return bilinear(input, input + ".size(2) * " + f, input + ".size(3) * " + f);
    case LayerKind::kPool: {
      const std::string pair = "[" + f + ", " + f + "]";
      return "torch.avg_pool2d(" + input + ", " + pair + ", " + pair + ", [0, 0], True, False)";
    }
    case LayerKind::kResize: {
      const std::string like = value_name(layer.like);
      return bilinear(input, like + ".size(2)", like + ".size(3)");
    }
  }
  return "";
}

}  // namespace

std::string script_of(const Description& network) {
  std::string text = "def forward(self, x):\n";
  for (std::size_t i = 0; i < network.layers.size(); ++i) {
    const Layer& layer = network.layers[i];
    const std::string name = value_name(static_cast<int>(i) + 1);
    text += "  " + name + " = " + line(network, layer) + "\n";
    if (layer.activation != Activation::kPrelu) continue;
    text += "  " + name + " = torch.relu(" + name + ") - self." + layer.name +
            "_slope.view([1, -1, 1, 1]) * torch.relu(-" + name + ")\n";
  }
  return text + "  return " + value_name(network.values() - 1) + ".to(x.dtype)\n";
}

}  // namespace pleat::superres
