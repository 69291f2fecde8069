#include "services/superres/cpu/trainable_layers.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <numeric>
#include <utility>

namespace pleat::superres::cpu {
namespace {

std::vector<int> range(int begin, int count) {
  std::vector<int> places(static_cast<std::size_t>(count));
  std::iota(places.begin(), places.end(), begin);
  return places;
}

/// Calls use(name, first output, outputs) for the layers of a convolution, side by side.
template <typename Use>
void for_parts(const Convolution& c, const Use& use) {
  const int part = c.outputs / static_cast<int>(c.names.size());
  for (std::size_t i = 0; i < c.names.size(); ++i) use(c.names[i], static_cast<int>(i) * part, part);
}

/// Weights of a 1x1 convolution, in the kernels' blocks, from (k, n).
void pack1(const Kernels& kernels, const float* taps, int k, int n, void* target) {
  const auto depth = static_cast<std::size_t>(k), columns = static_cast<std::size_t>(n);
  const auto block = static_cast<std::size_t>(kernels.block);
  alignas(64) float values[16];
  alignas(64) std::uint16_t halves[16];
  const auto lanes = static_cast<std::size_t>(kernels.lanes);
  for (std::size_t i = 0; i < depth; ++i) {
    for (std::size_t j = 0; j < columns; j += lanes) {
      const std::size_t first = j / block * block, width = std::min(block, columns - first);
      if (kernels.element == 4) {
        std::memcpy(static_cast<float*>(target) + first * depth + i * width + j - first, &taps[i * columns + j],
                    lanes * sizeof(float));
        continue;
      }
      std::copy_n(&taps[i * columns + j], lanes, values);
      kernels.store(values, halves, kernels.lanes);
      auto* place = static_cast<std::uint16_t*>(target) + first * depth + (i / 2 * width + j - first) * 2 + i % 2;
      for (std::size_t l = 0; l < lanes; ++l) place[2 * l] = halves[l];
    }
  }
}

/// Brings weights of several convolutions into one of (taps, k, n), and that into the kernels' order.
class Packer {
 public:
  using Parameters = std::map<std::string, Parameter>;
  Packer(const Parameters& parameters, std::size_t largest)
      : parameters_(parameters), buffer_(largest * sizeof(float)) {}

  void clear(std::size_t size) const { std::fill_n(taps(), size, 0.0F); }

  /// For the forward pass: inputs at their places.
  void add(const Convolution& c) const {
    const auto n = static_cast<std::size_t>(c.padded_outputs), step = times(c.inputs, c.padded_outputs);
    for_weights(c, [&](int o, int place, const float* w) {
      float* target = taps() + static_cast<std::size_t>(place) * n + o;
      for (std::size_t t = 0; t < c.taps(); ++t) target[t * step] = w[t];
    });
  }

  /// For the gradient of inputs [n_first, n_first + n): outputs become rows of k from k_first on, and a 3x3 kernel
  /// turns by half a circle.
  void add_turned(const Convolution& c, int k, int k_first, int n, int n_first) const {
    const std::size_t step = times(k, n), last = c.taps() - 1;
    for_weights(c, [&](int o, int place, const float* w) {
      const int column = place - n_first;
      if (column < 0 || column >= n) return;
      float* target = taps() + times(k_first + o, n) + column;
      for (std::size_t t = 0; t <= last; ++t) target[(last - t) * step] = w[t];
    });
  }

  void pack(const Kernels& kernels, int kernel, int k, int n, const Buffer& target) const {
    if (kernel == 3) {
      kernels.pack3(taps(), k, n, target.data());
    } else {
      pack1(kernels, taps(), k, n, target.data());
    }
  }

 private:
  float* taps() const { return buffer_.floats(); }

  /// Calls use(output, place of the input, its taps).
  template <typename Use>
  void for_weights(const Convolution& c, const Use& use) const {
    for_parts(c, [&](const std::string& name, int first, int count) {
      const float* w = parameters_.at(name + "_weight").value;
      for (int o = first; o < first + count; ++o) {
        for (const int place : c.places) {
          use(o, place, w);
          w += c.taps();
        }
      }
    });
  }

  const Parameters& parameters_;
  const Buffer buffer_;
};

}  // namespace

TrainableLayers::TrainableLayers(const Architecture& architecture, const TrainableOptions& o)
    : a(architecture), options(o), g(o.height, o.width) {
  plain = &float32_kernels(o.base_instructions);
  body = o.bfloat16 ? &bfloat16_kernels() : plain;
  element = body->element;
  const int lanes = std::max(plain->lanes, body->lanes);
  features = round_up(a.features, lanes), growth = round_up(a.growth, lanes), inputs = round_up(o.inputs, lanes);
  dense = a.kind == "mfsr", subpixel = a.upsampling == "subpixel";
  describe();
  const std::size_t widest =
      times(std::max({stack_channels(), a.blocks * features, kChannels * kScale * kScale, inputs}), 4);
  no_bias = Buffer(widest), zero_slope = Buffer(widest);
}

std::size_t TrainableLayers::add(const Kernels& kernels, std::vector<std::string> names, int kernel,
                                 std::vector<int> places, int padded_inputs, int output_count) {
  Convolution c;
  c.names = std::move(names), c.kernel = kernel, c.places = std::move(places);
  c.inputs = padded_inputs, c.outputs = output_count;
  c.padded_outputs = round_up(output_count, std::max(plain->lanes, body->lanes));
  const std::size_t points = kernel == 3 ? kPoints : 1;
  c.weights = Buffer(points * times(c.inputs, c.padded_outputs) * static_cast<std::size_t>(kernels.element));
  c.bias = Buffer(static_cast<std::size_t>(c.padded_outputs) * sizeof(float));
  convolutions.push_back(std::move(c));
  return convolutions.size() - 1;
}

Buffer TrainableLayers::back_buffer(int k, int n, bool one, const Kernels& kernels) const {
  return Buffer((one ? 1 : kPoints) * times(k, n) * static_cast<std::size_t>(kernels.element));
}

void TrainableLayers::describe() {
  shallow0 = add(*plain, {"shallow0"}, 3, range(0, options.inputs), inputs, a.features);
  shallow1 = add(*plain, {"shallow1"}, 3, range(0, a.features), features, a.features);
  back_shallow1 = back_buffer(features, features, false, *plain);
  std::vector<int> hierarchy;
  for (int d = 0; d < a.blocks; ++d) {
    const std::string block = "block" + std::to_string(d);
    auto& list = layers.emplace_back();
    auto& back = back_layers.emplace_back();
    if (!dense) {
      for (const char* part : {"_first", "_second"}) {
        list.push_back(add(*body, {block + part}, 3, range(0, a.features), features, a.features));
        back.push_back(back_buffer(features, features, false, *body));
      }
      continue;
    }
    auto places = range(0, a.features);
    back.push_back(back_buffer(a.layers * growth, features, false, *body));
    for (int c = 0; c < a.layers; ++c) {
      const int k = features + c * growth;
      list.push_back(add(*body, {block + "_dense" + std::to_string(c)}, 3, places, k, a.growth));
      const auto more = range(k, a.growth);
      places.insert(places.end(), more.begin(), more.end());
      back.push_back(back_buffer((a.layers - 1 - c) * growth, growth, false, *body));
    }
    fusions.push_back(add(*body, {block + "_fusion"}, 1, places, stack_channels(), a.features));
    back_fusions.push_back(back_buffer(features, stack_channels(), true, *body));
    const auto own = range(d * features, a.features);
    hierarchy.insert(hierarchy.end(), own.begin(), own.end());
  }
  if (dense) {
    global0 = add(*body, {"global0"}, 1, hierarchy, a.blocks * features, a.features);
    back_global0 = back_buffer(features, a.blocks * features, true, *body);
  }
  global1 = add(*body, {"global1"}, 3, range(0, a.features), features, a.features);
  back_global1 = back_buffer(features, features, false, *body);
  if (subpixel) {
    heads =
        add(*body, {"head_displacement", "head_normal", "head_velocity"}, 3, range(0, a.features), features, outputs());
    back_heads = back_buffer(convolutions[heads].padded_outputs, features, false, *body);
  }
}

void TrainableLayers::load(const Find& find) {
  std::map<std::string, Parameter> parameters;
  std::size_t largest = 0;
  for (const Convolution& c : convolutions) {
    largest = std::max(largest, c.size());
    for (const std::string& name : c.names) {
      for (const char* part : {"_weight", "_bias"}) parameters[name + part] = find(name + part);
    }
  }
  const Packer packer(parameters, largest * static_cast<std::size_t>(1 + a.layers));
  for (std::size_t index = 0; index < convolutions.size(); ++index) {
    const Convolution& c = convolutions[index];
    packer.clear(c.size());
    packer.add(c);
    packer.pack(index == shallow0 || index == shallow1 ? *plain : *body, c.kernel, c.inputs, c.padded_outputs,
                c.weights);
    for_parts(c, [&](const std::string& name, int first, int count) {
      std::copy_n(parameters.at(name + "_bias").value, count, c.bias.floats() + first);
    });
  }
  const auto turn = [&](std::size_t index, const Kernels& kernels, const Buffer& target) {
    const Convolution& c = convolutions[index];
    packer.clear(c.size());
    packer.add_turned(c, c.padded_outputs, 0, c.inputs, 0);
    packer.pack(kernels, c.kernel, c.padded_outputs, c.inputs, target);
  };
  turn(shallow1, *plain, back_shallow1);
  turn(global1, *body, back_global1);
  if (subpixel) turn(heads, *body, back_heads);
  if (dense) turn(global0, *body, back_global0);
  for (std::size_t d = 0; d < layers.size(); ++d) {
    if (!dense) {
      for (std::size_t part = 0; part < 2; ++part) turn(layers[d][part], *body, back_layers[d][part]);
      continue;
    }
    turn(fusions[d], *body, back_fusions[d]);
    for (int slot = 0; slot < a.layers; ++slot) {
      // Slot 0 is f, slot s the output of layer s - 1; layer c reads the slots up to c.
      const int n = slot == 0 ? features : growth, first = slot == 0 ? 0 : features + (slot - 1) * growth;
      const int depth = (a.layers - slot) * growth;
      packer.clear(9 * times(depth, n));
      for (int c = slot; c < a.layers; ++c) {
        packer.add_turned(convolutions[layers[d][static_cast<std::size_t>(c)]], depth, (c - slot) * growth, n, first);
      }
      packer.pack(*body, 3, depth, n, back_layers[d][static_cast<std::size_t>(slot)]);
    }
  }
}

void TrainableLayers::add_gradients(const std::vector<Gradient>& sums, const Find& find) const {
  for (std::size_t index = 0; index < convolutions.size(); ++index) {
    const Convolution& c = convolutions[index];
    const std::size_t k = static_cast<std::size_t>(c.inputs), n = static_cast<std::size_t>(c.padded_outputs);
    const float* taps = sums[index].taps.floats();
    const float* biases = sums[index].bias.floats();
    for_parts(c, [&](const std::string& name, int first, int count) {
      float* weight = find(name + "_weight").gradient;
      for (int o = first; o < first + count; ++o) {
        for (const int place : c.places) {
          for (std::size_t t = 0; t < c.taps(); ++t) {
            *weight++ += taps[(t * k + static_cast<std::size_t>(place)) * n + static_cast<std::size_t>(o)];
          }
        }
      }
      float* bias = find(name + "_bias").gradient;
      for (int o = 0; o < count; ++o) bias[o] += biases[first + o];
    });
  }
}

}  // namespace pleat::superres::cpu
