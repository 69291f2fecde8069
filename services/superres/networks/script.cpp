#include "services/superres/networks/script.hpp"

#include <cmath>
#include <initializer_list>
#include <vector>

namespace pleat::superres {
namespace {

std::string value_name(int value) { return value == 0 ? "x" : "v" + std::to_string(value); }

/// Layers that have no type of their own keep that of their input.
bool is_exact(const Description& network, int value) {
  if (value == 0) return true;
  const Layer& layer = network.layers[static_cast<std::size_t>(value) - 1];
  const bool float32 = layer.kind == LayerKind::kMemory || layer.kind == LayerKind::kJoin ||
                       layer.kind == LayerKind::kTokens || layer.kind == LayerKind::kMean;
  if (float32) return true;
  const bool typed = layer.kind == LayerKind::kConvolution || layer.kind == LayerKind::kNorm;
  return typed ? layer.exact : is_exact(network, layer.inputs[0]);
}

std::string in_type_of(const Description& network, const Layer& layer, int value) {
  const std::string name = value_name(value);
  const std::string& weights = layer.tied.empty() ? layer.name : layer.tied;
  return is_exact(network, value) == layer.exact ? name : name + ".to(self." + weights + "_weight.dtype)";
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

std::string number(int value) { return std::to_string(value); }
std::string list(std::initializer_list<std::string> values) {
  std::string text;
  for (const std::string& value : values) text += (text.empty() ? "[" : ", ") + value;
  return text + "]";
}
std::string places_of(const std::string& value) { return value + ".size(2) * " + value + ".size(3)"; }
/// Channels [first, first + count).
std::string part(const std::string& value, int first, int count) {
  return value + ".narrow(1, " + number(first) + ", " + number(count) + ")";
}

/// Lines before the one that names the result, which is returned.
std::string attention(const Layer& layer, const std::string& name, std::string& before) {
  const std::string whole = value_name(layer.inputs[0]), parts = name + "_parts", weights = name + "_weights";
  const int width = layer.channels / (layer.frames * layer.heads);
  const auto parted = [&](const std::string& value, const std::string& target, int count) {
    before += "  " + target + " = " + value + ".reshape(" +
              list({"-1", number(layer.frames), number(count), number(layer.heads), number(width), places_of(value)}) +
              ")\n";
  };
  std::string q = parts + ".select(2, 0)", k = parts + ".select(2, 1)", v = parts + ".select(2, 2)";
  parted(whole, parts, layer.inputs.size() > 1 ? 1 : 3);
  if (layer.inputs.size() > 1) {
    const std::string others = name + "_others";
    parted(value_name(layer.inputs[1]), others, 2);
    k = others + ".select(2, 0)", v = others + ".select(2, 1)";
  }
  const std::string scale = " * " + std::to_string(1 / std::sqrt(static_cast<double>(width)));
  std::string result;
  if (layer.over_frames) {
    std::string hidden;
    if (layer.causal) {
      const std::string frames = number(layer.frames);
      hidden = " + torch.triu(torch.full(" + list({frames, frames}) + ", -1e9, device=x.device), 1).reshape(" +
               list({frames, frames, "1", "1"}) + ")";
    }
    before += "  " + weights + " = torch.softmax((" + q + ".unsqueeze(2) * " + k + ".unsqueeze(1)).sum([4])" + scale +
              hidden + ", 2)\n";
    result = "(" + weights + ".unsqueeze(4) * " + v + ".unsqueeze(1)).sum([2])";
  } else {
    before +=
        "  " + weights + " = torch.softmax(torch.matmul(" + q + ".transpose(3, 4), " + k + ")" + scale + ", -1)\n";
    result = "torch.matmul(" + v + ", " + weights + ".transpose(3, 4))";
  }
  return result + shaped(whole + ".size(0)", layer.channels, whole);
}

std::string spread(const Layer& layer) {
  const std::string x = value_name(layer.inputs[0]);
  return part(x, 0, layer.frames * layer.parts * layer.each) + ".reshape(" +
         list({"-1", number(layer.frames), number(layer.parts), number(layer.each), places_of(x)}) + ").narrow(3, 0, " +
         number(layer.channels / layer.frames) + ").transpose(2, 3).reshape(" +
         list({x + ".size(0)", number(layer.channels), "1", number(layer.parts) + " * " + places_of(x)}) + ")";
}

std::string mean(const Layer& layer) {
  const std::string x = value_name(layer.inputs[0]), self = "self." + layer.name;
  const std::string count = x + ".size(0)", channels = x + ".size(1)";
  return "(torch.constant_pad_nd(" + x + ".flatten(2), [0, 1], 0.0).index_select(2, " + self + "_places).reshape(" +
         list({count, channels, number(layer.size.height * layer.size.width), "-1"}) + ").sum([3]) * " + self +
         "_shares).reshape(" + list({count, channels, number(layer.size.height), number(layer.size.width)}) + ")";
}

std::string tokens(const Description& network, const Layer& layer) {
  const std::string x = value_name(layer.inputs[0]), self = "self." + layer.name, frames = number(layer.frames);
  const int numbers = network.channels(layer.inputs[0]) / layer.frames;
  return "(" + x + ".reshape(" + list({"-1", frames, "1", number(numbers)}) + ") * " + self + "_weight + " + self +
         "_bias + " + self + "_time.reshape(" + list({"1", frames, number(layer.channels / layer.frames), "1"}) +
         ")).reshape(" + list({"-1", number(layer.channels), "1", number(numbers)}) + ")";
}

std::string joined(const Description& network, const Layer& layer) {
  std::string text;
  for (const int value : layer.inputs) {
    text += (text.empty() ? "" : ", ") + value_name(value) + (is_exact(network, value) ? "" : ".to(torch.float32)");
  }
  return "torch.cat([" + text + "], 1)";
}

std::string convolution(const Description& network, const Layer& layer) {
  std::string input;
  for (const int value : layer.inputs) {
    input += (input.empty() ? "" : ", ") + in_type_of(network, layer, value);
    if (layer.frames > 1) input += shaped("-1", network.channels(value) / layer.frames, value_name(value));
  }
  if (layer.inputs.size() > 1) input = "torch.cat([" + input + "], 1)";
  const std::string pad = number(layer.kernel / 2), self = "self." + layer.name;
  const std::string whole = value_name(layer.inputs[0]);
  std::string weight = self + "_weight";
  if (!layer.tied.empty()) {
    const int count = static_cast<int>(layer.inputs.size());
    const int each = layer.channels / layer.frames, from = network.input_channels(layer) / layer.frames / count;
    weight = "self." + layer.tied + "_weight.reshape(" + list({number(from), number(count), number(each)}) +
             ").permute([2, 1, 0]).reshape(" + list({number(each), number(count * from), "1", "1"}) + ")";
  }
  std::string result =
      "torch.conv2d(" + input + ", " + weight + ", " + self + "_bias, [1, 1], [" + pad + ", " + pad + "])";
  if (layer.frames > 1) result += shaped(whole + ".size(0)", layer.channels, whole);
  if (layer.add >= 0) result += " + " + in_type_of(network, layer, layer.add);
  switch (layer.activation) {
    case Activation::kRelu:
      return "torch.relu(" + result + ")";
    case Activation::kTanh:
      return "torch.tanh(" + result + ")";
    case Activation::kLeakyRelu:
      return "torch.leaky_relu(" + result + ", 0.02)";
    case Activation::kNone:
    case Activation::kPrelu:
      break;
  }
  return result;
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
    case LayerKind::kUnshuffle:
      return "torch.pixel_unshuffle(" + input + ", " + f + ")";
    case LayerKind::kSpread:
      return spread(layer);
    case LayerKind::kMean:
      return mean(layer);
    case LayerKind::kReshape:
      return input + ".reshape(" +
             list({input + ".size(0)", number(layer.channels), number(layer.size.height), number(layer.size.width)}) +
             ")";
    case LayerKind::kPart:
      return part(input, layer.first, layer.channels);
    case LayerKind::kJoin:
      return joined(network, layer);
    case LayerKind::kTokens:
      return tokens(network, layer);
    case LayerKind::kMemory:
      return "memory";
    case LayerKind::kGiven:
      break;
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
  std::vector<int> wanted{network.values() - 1};
  if (network.remembers()) wanted.push_back(network.memory);
  const std::vector<bool> needed = network.needed(wanted);
  std::string text = network.remembers() ? "def forward(self, x, memory):\n" : "def forward(self, x):\n";
  for (std::size_t i = 0; i < network.layers.size(); ++i) {
    if (!needed[i]) continue;
    const Layer& layer = network.layers[i];
    const std::string name = value_name(static_cast<int>(i) + 1);
    std::string before;
    const std::string expression = line(network, layer, name, before);
    text += before + "  " + name + " = " + expression + "\n";
    if (layer.activation != Activation::kPrelu) continue;
    text += "  " + name + " = torch.relu(" + name + ") - self." + layer.name +
            "_slope.view([1, -1, 1, 1]) * torch.relu(-" + name + ")\n";
  }
  const std::string answer = value_name(network.values() - 1) + ".to(x.dtype)";
  if (!network.remembers()) return text + "  return " + answer + "\n";
  const int each = network.channels(network.memory);
  const std::string limit = std::to_string(kMemoryLimit);
  return text + "  return " + answer + ", torch.cat([" + part("memory", each, (network.remembered - 1) * each) + ", " +
         value_name(network.memory) + ".to(x.dtype)], 1).clamp(-" + limit + ", " + limit + ")\n";
}

}  // namespace pleat::superres
