#include "services/superres/networks/script.hpp"

#include <cmath>

namespace pleat::superres {
namespace {

std::string value_name(int value) { return value == 0 ? "x" : "v" + std::to_string(value); }

/// Layers that have no type of their own keep that of their input.
bool is_exact(const Description& network, int value) {
  if (value == 0) return true;
  const Layer& layer = network.layers[static_cast<std::size_t>(value) - 1];
  const bool typed = layer.kind == LayerKind::kConvolution || layer.kind == LayerKind::kNorm;
  return typed ? layer.exact : is_exact(network, layer.inputs[0]);
}

std::string in_type_of(const Description& network, const Layer& layer, int value) {
  const std::string name = value_name(value);
  return is_exact(network, value) == layer.exact ? name : name + ".to(self." + layer.name + "_weight.dtype)";
}

/// ".reshape(...)" to `first` images of so many channels, as high and wide as `like`.
std::string shaped(const std::string& first, int channels, const std::string& like) {
  return ".reshape([" + first + ", " + std::to_string(channels) + ", " + like + ".size(2), " + like + ".size(3)])";
}

std::string norm(const Description& network, const Layer& layer) {
  const std::string whole = value_name(layer.inputs[0]), self = "self." + layer.name;
  const std::string channels = std::to_string(layer.channels / layer.frames);
  std::string result = "torch.layer_norm(" + in_type_of(network, layer, layer.inputs[0]) + ".reshape([-1, " + channels +
                       ", " + whole + ".size(2) * " + whole + ".size(3)]).transpose(1, 2), [" + channels + "], " +
                       self + "_weight, " + self + "_bias).transpose(1, 2)" +
                       shaped(whole + ".size(0)", layer.channels, whole);
  if (layer.add >= 0) result += " + " + in_type_of(network, layer, layer.add);
  return result;
}

/// Lines before the one that names the result, which is returned.
std::string attention(const Layer& layer, const std::string& name, std::string& before) {
  const std::string whole = value_name(layer.inputs[0]), parts = name + "_parts", weights = name + "_weights";
  const int width = layer.channels / (layer.frames * layer.heads);
  const std::string q = parts + ".select(2, 0)", k = parts + ".select(2, 1)", v = parts + ".select(2, 2)";
  const std::string scale = " * " + std::to_string(1 / std::sqrt(static_cast<double>(width)));
  before = "  " + parts + " = " + whole + ".reshape([-1, " + std::to_string(layer.frames) + ", 3, " +
           std::to_string(layer.heads) + ", " + std::to_string(width) + ", " + whole + ".size(2) * " + whole +
           ".size(3)])\n  " + weights + " = ";
  std::string result;
  if (layer.over_frames) {
    before += "torch.softmax((" + q + ".unsqueeze(2) * " + k + ".unsqueeze(1)).sum([4])" + scale + ", 2)\n";
    result = "(" + weights + ".unsqueeze(4) * " + v + ".unsqueeze(1)).sum([2])";
  } else {
    before += "torch.softmax(torch.matmul(" + q + ".transpose(3, 4), " + k + ")" + scale + ", -1)\n";
    result = "torch.matmul(" + v + ", " + weights + ".transpose(3, 4))";
  }
  return result + shaped(whole + ".size(0)", layer.channels, whole);
}

std::string convolution(const Description& network, const Layer& layer) {
  std::string input;
  for (const int value : layer.inputs) input += (input.empty() ? "" : ", ") + in_type_of(network, layer, value);
  if (layer.inputs.size() > 1) input = "torch.cat([" + input + "], 1)";
  const std::string pad = std::to_string(layer.kernel / 2), self = "self." + layer.name;
  const std::string whole = value_name(layer.inputs[0]);
  if (layer.frames > 1) {
    input += shaped("-1", network.input_channels(layer) / layer.frames, whole);
  }
  std::string result =
      "torch.conv2d(" + input + ", " + self + "_weight, " + self + "_bias, [1, 1], [" + pad + ", " + pad + "])";
  if (layer.frames > 1) result += shaped(whole + ".size(0)", layer.channels, whole);
  if (layer.add >= 0) result += " + " + in_type_of(network, layer, layer.add);
  return layer.activation == Activation::kRelu ? "torch.relu(" + result + ")" : result;
}

std::string bilinear(const std::string& input, const std::string& height, const std::string& width) {
  return "torch.upsample_bilinear2d(" + input + ", [" + height + ", " + width + "], False)";
}

/// The expression of a layer. before: lines that it needs first.
std::string line(const Description& network, const Layer& layer, const std::string& name, std::string& before) {
  const std::string input = value_name(layer.inputs[0]), f = std::to_string(layer.factor);
  switch (layer.kind) {
    case LayerKind::kConvolution:
      return convolution(network, layer);
    case LayerKind::kNorm:
      return norm(network, layer);
    case LayerKind::kAttention:
      return attention(layer, name, before);
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
    std::string before;
    const std::string expression = line(network, layer, name, before);
    text += before + "  " + name + " = " + expression + "\n";
    if (layer.activation != Activation::kPrelu) continue;
    text += "  " + name + " = torch.relu(" + name + ") - self." + layer.name +
            "_slope.view([1, -1, 1, 1]) * torch.relu(-" + name + ")\n";
  }
  return text + "  return " + value_name(network.values() - 1) + ".to(x.dtype)\n";
}

}  // namespace pleat::superres
