#include "services/superres/cpu/trainable.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <numeric>
#include <vector>

#include "common/base/error.hpp"
#include "services/superres/cpu/team.hpp"
#include "services/superres/cpu/weights.hpp"

namespace pleat::superres::cpu {
namespace {

/// A convolution and where its channels lie in padded images.
struct Convolution {
  std::vector<std::string> names;  ///< of the layers that make its outputs, side by side ("head_...": three)
  int kernel = 3;
  std::vector<int> places;  ///< of its input channels
  int inputs = 0;           ///< padded
  int outputs = 0, padded_outputs = 0;
  Buffer weights, bias;  ///< for the forward pass
  std::size_t taps() const { return static_cast<std::size_t>(kernel * kernel); }
  std::size_t size() const {
    return taps() * static_cast<std::size_t>(inputs) * static_cast<std::size_t>(padded_outputs);
  }
};

/// Sums of one thread over its images.
struct Gradient {
  Buffer taps, bias;  ///< (taps, inputs, padded outputs), (padded outputs)
};

struct Features {
  Buffer buffer;
  int stride = 0;
  Features() = default;
  Features(const Geometry& g, int channels, int element)
      : buffer(g.pixels() * static_cast<std::size_t>(channels) * static_cast<std::size_t>(element)), stride(channels) {}
};

/// What the backward pass needs of one image.
struct Kept {
  Features input, shallow;          ///< float32
  std::vector<Features> stacks;     ///< elements: f and its layers; "srresnet": f and what is between the two layers
  Features hierarchy, fused, last;  ///< elements
};

/// Scratch of one thread.
struct Worker {
  Features trunk, stack_gradient, hierarchy_gradient, shallow_gradient;  ///< float32
  Features small, layers, answer;                                        ///< elements
  Features answer32;
  Buffer tiles, input_groups, output_groups, sums, scratch;
  std::vector<Gradient> gradients;  ///< one a convolution
};

std::size_t times(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

std::vector<int> range(int begin, int count) {
  std::vector<int> places(static_cast<std::size_t>(count));
  std::iota(places.begin(), places.end(), begin);
  return places;
}

/// An odd number of cache lines, so that planes don't fall on each other.
std::size_t plane_of(std::size_t elements, int element) {
  const std::size_t line = 64 / static_cast<std::size_t>(element);
  std::size_t lines = (elements + line - 1) / line;
  lines += 1 - lines % 2;
  return lines * line;
}

}  // namespace

struct Trainable::State {
  Architecture a;
  TrainableOptions options;
  Geometry g;
  const Kernels* plain;
  const Kernels* body;
  int element;
  int features, growth, inputs;  ///< padded
  bool dense, subpixel;
  Team team;

  std::vector<Convolution> convolutions;
  // Places in `convolutions`.
  std::size_t shallow0 = 0, shallow1 = 0, global0 = 0, global1 = 0, heads = 0;
  std::vector<std::vector<std::size_t>> layers;
  std::vector<std::size_t> fusions;

  // Weights of the gradients of inputs.
  Buffer back_shallow1, back_global0, back_global1, back_heads;
  std::vector<Buffer> back_fusions;
  std::vector<std::vector<Buffer>> back_layers;  ///< of a block: of f, then of each layer, from all later ones
  Buffer no_bias, zero_slope;

  std::vector<Kept> kept;
  std::vector<Worker> workers;
  int kept_count = 0;

  State(const Architecture& architecture, const TrainableOptions& o)
      : a(architecture), options(o), g(o.height, o.width), team(o.threads) {
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
    for (int w = 0; w < o.threads; ++w) workers.push_back(make_worker());
  }

  int stack_channels() const { return features + (dense ? a.layers * growth : features); }
  int outputs() const { return subpixel ? kChannels * kScale * kScale : a.features; }

  std::size_t add(const Kernels& kernels, std::vector<std::string> names, int kernel, std::vector<int> places,
                  int padded_inputs, int output_count) {
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

  Buffer back_buffer(int k, int n, bool one, const Kernels& kernels) const {
    return Buffer((one ? 1 : kPoints) * times(k, n) * static_cast<std::size_t>(kernels.element));
  }

  void describe() {
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
      heads = add(*body, {"head_displacement", "head_normal", "head_velocity"}, 3, range(0, a.features), features,
                  outputs());
      back_heads = back_buffer(convolutions[heads].padded_outputs, features, false, *body);
    }
  }

  Worker make_worker() const {
    Worker w;
    w.trunk = Features(g, features, 4);
    w.stack_gradient = Features(g, stack_channels(), 4);
    w.hierarchy_gradient = Features(g, dense ? a.blocks * features : 16, 4);
    w.shallow_gradient = Features(g, features, 4);
    w.small = Features(g, features, element);
    w.layers = Features(g, std::max(dense ? a.layers * growth : features, features), element);
    const int answers = subpixel ? convolutions[heads].padded_outputs : features;
    w.answer = Features(g, answers, element);
    w.answer32 = Features(g, answers, 4);
    const int lists = std::max({stack_channels(), inputs, answers, a.blocks * features});
    // Elements of four bytes: the shallow convolutions use the same buffers.
    w.tiles = Buffer(g.tiles() * kPoints * static_cast<std::size_t>(std::max({stack_channels(), inputs, answers})) * 4);
    const std::size_t members = std::max(g.tiles() + 1, (times(g.height, g.width) + kPoints) / kPoints + 1) * kPoints;
    w.input_groups = Buffer((members * static_cast<std::size_t>(lists) + 64 * kPoints) * 4);
    w.output_groups = Buffer((members * static_cast<std::size_t>(lists) + 64 * kPoints) * 4);
    std::size_t largest = 0;
    for (const Convolution& c : convolutions) {
      largest = std::max(largest, (c.kernel == 3 ? kPoints : 1) * times(c.inputs, c.padded_outputs));
      w.gradients.push_back({Buffer(c.size() * sizeof(float)), Buffer(times(c.padded_outputs, 4))});
    }
    w.sums = Buffer(largest * sizeof(float));
    w.scratch = Buffer(kScratch * sizeof(float));
    return w;
  }

  Kept make_kept() const {
    Kept k;
    k.input = Features(g, inputs, 4);
    k.shallow = Features(g, features, 4);
    for (int d = 0; d < a.blocks; ++d) k.stacks.emplace_back(g, stack_channels(), element);
    if (dense) k.hierarchy = Features(g, a.blocks * features, element);
    k.fused = Features(g, features, element);
    k.last = Features(g, features, element);
    return k;
  }

  /// Calls use(name, its outputs) for the layers of a convolution, side by side.
  template <typename Use>
  static void for_parts(const Convolution& c, const Use& use) {
    const int part = c.outputs / static_cast<int>(c.names.size());
    for (std::size_t i = 0; i < c.names.size(); ++i) use(c.names[i], static_cast<int>(i) * part, part);
  }

  void load(const std::function<Parameter(const std::string&)>& find) {
    std::map<std::string, Parameter> parameters;
    for (const Convolution& c : convolutions) {
      for (const std::string& name : c.names) {
        for (const char* part : {"_weight", "_bias"}) parameters[name + part] = find(name + part);
      }
    }
    std::size_t largest = 0;
    for (const Convolution& c : convolutions) largest = std::max(largest, c.size());
    const Buffer taps_buffer(largest * static_cast<std::size_t>(1 + a.layers) * sizeof(float));
    float* taps = taps_buffer.floats();
    const auto weight = [&](const Convolution& c, const auto& use) {
      for_parts(c, [&](const std::string& name, int first, int count) {
        const float* w = parameters.at(name + "_weight").value;
        for (int o = 0; o < count; ++o) {
          for (std::size_t i = 0; i < c.places.size(); ++i) {
            for (std::size_t t = 0; t < c.taps(); ++t) use(first + o, i, t, *w++);
          }
        }
      });
    };
    const auto pack = [&](const Kernels& kernels, int kernel, int k, int n, Buffer& target) {
      if (kernel == 3) {
        kernels.pack3(taps, k, n, target.data());
      } else {
        pack1(kernels, taps, k, n, target.data());
      }
    };
    for (std::size_t index = 0; index < convolutions.size(); ++index) {
      Convolution& c = convolutions[index];
      const Kernels& kernels = index == shallow0 || index == shallow1 ? *plain : *body;
      const std::size_t n = static_cast<std::size_t>(c.padded_outputs), k = static_cast<std::size_t>(c.inputs);
      std::fill_n(taps, c.size(), 0.0F);
      weight(c, [&](int o, std::size_t i, std::size_t t, float w) {
        taps[(t * k + static_cast<std::size_t>(c.places[i])) * n + static_cast<std::size_t>(o)] = w;
      });
      pack(kernels, c.kernel, c.inputs, c.padded_outputs, c.weights);
      for_parts(c, [&](const std::string& name, int first, int count) {
        std::copy_n(parameters.at(name + "_bias").value, count, c.bias.floats() + first);
      });
    }
    // Gradients of inputs: outputs become inputs, and a 3x3 kernel turns by half a circle.
    const auto back = [&](const Convolution& c, int k, int k_first, int n, int n_first, bool fresh) {
      const std::size_t depth = static_cast<std::size_t>(k), columns = static_cast<std::size_t>(n);
      if (fresh) std::fill_n(taps, c.taps() * depth * columns, 0.0F);
      weight(c, [&](int o, std::size_t i, std::size_t t, float w) {
        const int column = c.places[i] - n_first;
        if (column < 0 || column >= n) return;
        taps[((c.taps() - 1 - t) * depth + static_cast<std::size_t>(k_first + o)) * columns +
             static_cast<std::size_t>(column)] = w;
      });
    };
    const auto whole = [&](std::size_t index, const Kernels& kernels, Buffer& target) {
      const Convolution& c = convolutions[index];
      back(c, c.padded_outputs, 0, c.inputs, 0, true);
      pack(kernels, c.kernel, c.padded_outputs, c.inputs, target);
    };
    whole(shallow1, *plain, back_shallow1);
    whole(global1, *body, back_global1);
    if (subpixel) whole(heads, *body, back_heads);
    if (dense) whole(global0, *body, back_global0);
    for (std::size_t d = 0; d < layers.size(); ++d) {
      if (!dense) {
        for (std::size_t part = 0; part < 2; ++part) whole(layers[d][part], *body, back_layers[d][part]);
        continue;
      }
      whole(fusions[d], *body, back_fusions[d]);
      for (int slot = 0; slot <= a.layers; ++slot) {
        // Slot 0 is f, slot s the output of layer s - 1; layer c reads the slots up to c.
        const int n = slot == 0 ? features : growth, first = slot == 0 ? 0 : features + (slot - 1) * growth;
        const int depth = (a.layers - slot) * growth;
        if (depth == 0) continue;
        for (int c = slot; c < a.layers; ++c) {
          back(convolutions[layers[d][static_cast<std::size_t>(c)]], depth, (c - slot) * growth, n, first, c == slot);
        }
        pack(*body, 3, depth, n, back_layers[d][static_cast<std::size_t>(slot)]);
      }
    }
  }

  static void pack1(const Kernels& kernels, const float* taps, int k, int n, void* target) {
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

  // --- one image -----------------------------------------------------------------------------------------------------

  ConvolutionCall call_of(const Convolution& c, Worker& w) const {
    ConvolutionCall call{};
    call.k = c.inputs, call.n = c.padded_outputs;
    call.weights = c.weights.data(), call.bias = c.bias.floats();
    call.scratch = w.scratch.floats();
    return call;
  }

  ConvolutionCall back_call(const Buffer& weights, int k, int n, Worker& w) const {
    ConvolutionCall call{};
    call.k = k, call.n = n;
    call.weights = weights.data(), call.bias = no_bias.floats();
    call.scratch = w.scratch.floats();
    return call;
  }

  /// A 3x3 convolution of channels [first, first + call.k) of an image.
  void convolve(const Kernels& kernels, const Features& image, int first, ConvolutionCall call, Worker& w) const {
    kernels.transform(g, {image.buffer.data(), image.stride, first, call.k, w.tiles.data(), call.k, 0, 0}, 0,
                      g.tiles_y);
    call.input = w.tiles.data(), call.input_stride = call.k;
    kernels.convolve3(g, call, 0, g.tiles_y);
  }

  float* pixel(const Features& image, int y, int x) const {
    return image.buffer.floats() + (static_cast<std::ptrdiff_t>(y + 1) * g.row + x + 1) * image.stride;
  }

  /// Calls use(index of the pixel).
  template <typename Use>
  void for_pixels(const Use& use) const {
    for (int y = 0; y < g.height; ++y) {
      for (int x = 0; x < g.width; ++x) use(static_cast<std::size_t>((y + 1) * g.row + x + 1));
    }
  }

  void narrow(const Features& from, int from_first, const Features& to, int to_first, int channels) const {
    for_pixels([&](std::size_t p) {
      body->store(from.buffer.floats() + p * static_cast<std::size_t>(from.stride) + from_first,
                  to.buffer.at(p * static_cast<std::size_t>(to.stride) + static_cast<std::size_t>(to_first), element),
                  channels);
    });
  }

  /// Planes (channels, h, w) to pixels and back.
  void read_planes(const float* planes, int channels, const Features& image) const {
    const std::ptrdiff_t size = std::ptrdiff_t{g.height} * g.width;
    for (int y = 0; y < g.height; ++y) {
      for (int x = 0; x < g.width; ++x) {
        float* target = pixel(image, y, x);
        const float* source = planes + static_cast<std::ptrdiff_t>(y) * g.width + x;
        for (int c = 0; c < channels; ++c) target[c] = source[c * size];
      }
    }
  }
  void write_planes(const Features& image, int channels, float* planes) const {
    const std::ptrdiff_t size = std::ptrdiff_t{g.height} * g.width;
    for (int y = 0; y < g.height; ++y) {
      for (int x = 0; x < g.width; ++x) {
        const float* source = pixel(image, y, x);
        float* target = planes + static_cast<std::ptrdiff_t>(y) * g.width + x;
        for (int c = 0; c < channels; ++c) target[c * size] = source[c];
      }
    }
  }

  void forward_image(const float* input, Kept& k, Worker& w, float* output) {
    read_planes(input, options.inputs, k.input);
    ConvolutionCall call = call_of(convolutions[shallow0], w);
    call.output = k.shallow.buffer.floats(), call.output_stride = features;
    convolve(*plain, k.input, 0, call, w);
    call = call_of(convolutions[shallow1], w);
    call.output = w.trunk.buffer.floats(), call.output_stride = features;
    convolve(*plain, k.shallow, 0, call, w);
    narrow(w.trunk, 0, k.stacks[0], 0, features);
    for (std::size_t d = 0; d < layers.size(); ++d) {
      // The next block's f, or after the last one what global1 reads of a residual network.
      const Features& next = d + 1 < layers.size() ? k.stacks[d + 1] : k.fused;
      if (dense) {
        forward_dense(d, k, w, d + 1 < layers.size() ? &next : nullptr);
      } else {
        forward_residual(d, k, w, next);
      }
    }
    if (dense) {
      call = call_of(convolutions[global0], w);
      call.input = k.hierarchy.buffer.data(), call.input_stride = k.hierarchy.stride;
      call.stored = k.fused.buffer.data(), call.stored_stride = features;
      body->convolve1(g, call, 0, g.tiles_y);
    }
    call = call_of(convolutions[global1], w);
    call.add = k.shallow.buffer.floats(), call.add_stride = features;
    call.stored = k.last.buffer.data(), call.stored_stride = features;
    if (!subpixel) call.output = w.answer32.buffer.floats(), call.output_stride = w.answer32.stride;
    convolve(*body, k.fused, 0, call, w);
    if (subpixel) {
      call = call_of(convolutions[heads], w);
      call.output = w.answer32.buffer.floats(), call.output_stride = w.answer32.stride;
      convolve(*body, k.last, 0, call, w);
    }
    write_planes(w.answer32, outputs(), output);
  }

  void forward_dense(std::size_t d, Kept& k, Worker& w, const Features* next) {
    const Features& stack = k.stacks[d];
    ConvolutionCall call{};
    for (int c = 0; c < a.layers; ++c) {
      const int from = c == 0 ? 0 : features + (c - 1) * growth;
      body->transform(
          g,
          {stack.buffer.data(), stack.stride, from, c == 0 ? features : growth, w.tiles.data(), stack.stride, from, 0},
          0, g.tiles_y);
      call = call_of(convolutions[layers[d][static_cast<std::size_t>(c)]], w);
      call.input = w.tiles.data(), call.input_stride = stack.stride;
      call.slope = zero_slope.floats();
      call.stored = stack.buffer.at(static_cast<std::size_t>(features + c * growth), element);
      call.stored_stride = stack.stride;
      body->convolve3(g, call, 0, g.tiles_y);
    }
    call = call_of(convolutions[fusions[d]], w);
    call.input = stack.buffer.data(), call.input_stride = stack.stride;
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = k.hierarchy.buffer.at(d * static_cast<std::size_t>(features), element);
    call.stored_stride = k.hierarchy.stride;
    if (next != nullptr) call.also_stored = next->buffer.data(), call.also_stored_stride = next->stride;
    body->convolve1(g, call, 0, g.tiles_y);
  }

  void forward_residual(std::size_t d, Kept& k, Worker& w, const Features& next) {
    const Features& stack = k.stacks[d];
    ConvolutionCall call = call_of(convolutions[layers[d][0]], w);
    call.slope = zero_slope.floats();
    call.stored = stack.buffer.at(static_cast<std::size_t>(features), element), call.stored_stride = stack.stride;
    convolve(*body, stack, 0, call, w);
    call = call_of(convolutions[layers[d][1]], w);
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = next.buffer.data(), call.stored_stride = next.stride;
    convolve(*body, stack, features, call, w);
  }

  /// Adds the gradient of a 3x3 convolution's weights and bias. Both images in elements of the kernels; the inputs are
  /// grouped already where input_first < 0.
  struct Sides {
    const Features* inputs;
    int input_first;
    const Features* outputs;
    int output_first;
  };
  void weight_gradient(const Kernels& kernels, std::size_t index, const Sides& sides, Worker& w) const {
    const Convolution& c = convolutions[index];
    const bool three = c.kernel == 3;
    const std::size_t members = three ? g.tiles() : times(g.height, g.width);
    const int groups = static_cast<int>((members + static_cast<std::size_t>(kernels.group) - 1) /
                                        static_cast<std::size_t>(kernels.group));
    const auto plane = [&](int channels) {
      return plane_of(times(groups, channels) * static_cast<std::size_t>(kernels.group), kernels.element);
    };
    const std::size_t a_plane = plane(c.inputs), b_plane = plane(c.padded_outputs);
    const auto group_in = three ? kernels.group_inputs : kernels.group_pixels;
    const auto group_out = three ? kernels.group_outputs : kernels.group_pixels;
    group_in(g, {sides.inputs->buffer.data(), sides.inputs->stride, sides.input_first, c.inputs, w.input_groups.data(),
                 a_plane, c.inputs, 0});
    group_out(g, {sides.outputs->buffer.data(), sides.outputs->stride, sides.output_first, c.padded_outputs,
                  w.output_groups.data(), b_plane, c.padded_outputs, 0});
    correlate(kernels, index,
              {w.input_groups.data(), a_plane, c.inputs, w.output_groups.data(), b_plane, c.padded_outputs, groups}, w);
    bias_gradient(kernels, *sides.outputs, sides.output_first, w.gradients[index].bias, c.padded_outputs);
  }

  struct Groups {
    const void* a;
    std::size_t a_plane;
    int a_stride;
    const void* b;
    std::size_t b_plane;
    int b_stride;
    int groups;
  };
  void correlate(const Kernels& kernels, std::size_t index, const Groups& groups, Worker& w) const {
    const Convolution& c = convolutions[index];
    const int points = c.kernel == 3 ? kPoints : 1;
    kernels.correlate({groups.a, groups.b, groups.a_plane, groups.b_plane, groups.a_stride, groups.b_stride, points,
                       groups.groups, c.inputs, c.padded_outputs, w.sums.floats()});
    float* target = w.gradients[index].taps.floats();
    if (c.kernel == 3) {
      kernels.add_taps(w.sums.floats(), c.inputs, c.padded_outputs, target);
    } else {
      for (std::size_t i = 0; i < c.size(); ++i) target[i] += w.sums.floats()[i];
    }
  }

  void bias_gradient(const Kernels& kernels, const Features& image, int first, const Buffer& target,
                     int channels) const {
    float* sums = target.floats();
    for_pixels([&](std::size_t p) {
      const void* source = image.buffer.at(p * static_cast<std::size_t>(image.stride) + static_cast<std::size_t>(first),
                                           kernels.element);
      if (kernels.element == 4) {
        const float* values = static_cast<const float*>(source);
        for (int c = 0; c < channels; ++c) sums[c] += values[c];
      } else {
        const auto* values = static_cast<const std::uint16_t*>(source);
        for (int c = 0; c < channels; ++c) {
          const std::uint32_t bits = static_cast<std::uint32_t>(values[c]) << 16;
          float value;
          std::memcpy(&value, &bits, sizeof value);
          sums[c] += value;
        }
      }
    });
  }

  void backward_image(const float* gradient, Kept& k, Worker& w) {
    read_planes(gradient, outputs(), w.answer32);
    // Gradient of `last`, in w.trunk; that of `shallow` begins with the same.
    if (subpixel) {
      const int channels = convolutions[heads].padded_outputs;
      narrow(w.answer32, 0, w.answer, 0, channels);
      weight_gradient(*body, heads, {&k.last, 0, &w.answer, 0}, w);
      ConvolutionCall call = back_call(back_heads, channels, features, w);
      call.output = w.shallow_gradient.buffer.floats(), call.output_stride = features;
      call.stored = w.small.buffer.data(), call.stored_stride = features;
      convolve(*body, w.answer, 0, call, w);
    } else {
      for_pixels([&](std::size_t p) {
        const float* source = w.answer32.buffer.floats() + p * static_cast<std::size_t>(w.answer32.stride);
        std::copy_n(source, features, w.shallow_gradient.buffer.floats() + p * static_cast<std::size_t>(features));
      });
      narrow(w.shallow_gradient, 0, w.small, 0, features);
    }
    weight_gradient(*body, global1, {&k.fused, 0, &w.small, 0}, w);
    ConvolutionCall call = back_call(back_global1, features, features, w);
    call.output = w.trunk.buffer.floats(), call.output_stride = features;
    convolve(*body, w.small, 0, call, w);
    if (dense) {
      narrow(w.trunk, 0, w.small, 0, features);
      weight_gradient(*body, global0, {&k.hierarchy, 0, &w.small, 0}, w);
      call = back_call(back_global0, features, a.blocks * features, w);
      call.input = w.small.buffer.data(), call.input_stride = features;
      call.output = w.hierarchy_gradient.buffer.floats(), call.output_stride = w.hierarchy_gradient.stride;
      body->convolve1(g, call, 0, g.tiles_y);
      const std::size_t last = static_cast<std::size_t>(a.blocks - 1) * static_cast<std::size_t>(features);
      for_pixels([&](std::size_t p) {
        std::copy_n(
            w.hierarchy_gradient.buffer.floats() + p * static_cast<std::size_t>(w.hierarchy_gradient.stride) + last,
            features, w.trunk.buffer.floats() + p * static_cast<std::size_t>(features));
      });
    }
    for (std::size_t d = layers.size(); d-- > 0;) {
      if (dense) {
        backward_dense(d, k, w);
      } else {
        backward_residual(d, k, w);
      }
    }
    // w.trunk is the gradient of shallow1's output.
    weight_gradient(*plain, shallow1, {&k.shallow, 0, &w.trunk, 0}, w);
    call = back_call(back_shallow1, features, features, w);
    call.add = call.output = w.shallow_gradient.buffer.floats();
    call.add_stride = call.output_stride = features;
    convolve(*plain, w.trunk, 0, call, w);
    weight_gradient(*plain, shallow0, {&k.input, 0, &w.shallow_gradient, 0}, w);
  }

  void backward_dense(std::size_t d, Kept& k, Worker& w) {
    const Features& stack = k.stacks[d];
    narrow(w.trunk, 0, w.small, 0, features);
    weight_gradient(*body, fusions[d], {&stack, 0, &w.small, 0}, w);
    ConvolutionCall call = back_call(back_fusions[d], features, stack_channels(), w);
    call.input = w.small.buffer.data(), call.input_stride = features;
    call.output = w.stack_gradient.buffer.floats(), call.output_stride = w.stack_gradient.stride;
    body->convolve1(g, call, 0, g.tiles_y);

    // Layers from the last to the first: each gets what the fusion and the later layers want of it.
    const int width = a.layers * growth;
    for (int c = a.layers - 1; c >= 0; --c) {
      const int slot = features + c * growth;
      const auto place = static_cast<std::size_t>(c * growth);
      if (c == a.layers - 1) {
        for_pixels([&](std::size_t p) {
          body->store_masked(
              w.stack_gradient.buffer.floats() + p * static_cast<std::size_t>(w.stack_gradient.stride) + slot,
              stack.buffer.at(p * static_cast<std::size_t>(stack.stride) + static_cast<std::size_t>(slot), element),
              w.layers.buffer.at(p * static_cast<std::size_t>(w.layers.stride) + place, element), growth);
        });
      } else {
        call = back_call(back_layers[d][static_cast<std::size_t>(c + 1)], (a.layers - 1 - c) * growth, growth, w);
        call.input = w.tiles.at(place + static_cast<std::size_t>(growth), element), call.input_stride = width;
        call.add = w.stack_gradient.buffer.floats() + slot, call.add_stride = w.stack_gradient.stride;
        call.mask = stack.buffer.at(static_cast<std::size_t>(slot), element), call.mask_stride = stack.stride;
        call.stored = w.layers.buffer.at(place, element), call.stored_stride = w.layers.stride;
        body->convolve3(g, call, 0, g.tiles_y);
      }
      body->transform(
          g, {w.layers.buffer.data(), w.layers.stride, c * growth, growth, w.tiles.data(), width, c * growth, 0}, 0,
          g.tiles_y);
    }
    // f: by the skip, the fusion, all layers, and as the output of the block before.
    const std::size_t before = (d - 1) * static_cast<std::size_t>(features);
    for_pixels([&](std::size_t p) {
      float* sum = w.trunk.buffer.floats() + p * static_cast<std::size_t>(features);
      const float* own = w.stack_gradient.buffer.floats() + p * static_cast<std::size_t>(w.stack_gradient.stride);
      for (int i = 0; i < features; ++i) sum[i] += own[i];
      if (d > 0) {
        const float* other =
            w.hierarchy_gradient.buffer.floats() + p * static_cast<std::size_t>(w.hierarchy_gradient.stride) + before;
        for (int i = 0; i < features; ++i) sum[i] += other[i];
      }
    });
    call = back_call(back_layers[d][0], width, features, w);
    call.input = w.tiles.data(), call.input_stride = width;
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    body->convolve3(g, call, 0, g.tiles_y);

    // Weights of all layers from one grouping of both sides.
    const int groups = (static_cast<int>(g.tiles()) + body->group - 1) / body->group;
    const int read = features + (a.layers - 1) * growth;
    const auto plane = [&](int channels) {
      return plane_of(times(groups, channels) * static_cast<std::size_t>(body->group), element);
    };
    body->group_inputs(g, {stack.buffer.data(), stack.stride, 0, read, w.input_groups.data(), plane(read), read, 0});
    body->group_outputs(
        g, {w.layers.buffer.data(), w.layers.stride, 0, width, w.output_groups.data(), plane(width), width, 0});
    for (int c = 0; c < a.layers; ++c) {
      const std::size_t index = layers[d][static_cast<std::size_t>(c)];
      correlate(*body, index,
                {w.input_groups.data(), plane(read), read,
                 w.output_groups.at(static_cast<std::size_t>(c * growth * body->group), element), plane(width), width,
                 groups},
                w);
      bias_gradient(*body, w.layers, c * growth, w.gradients[index].bias, growth);
    }
  }

  void backward_residual(std::size_t d, Kept& k, Worker& w) {
    const Features& stack = k.stacks[d];
    narrow(w.trunk, 0, w.small, 0, features);
    weight_gradient(*body, layers[d][1], {&stack, features, &w.small, 0}, w);
    ConvolutionCall call = back_call(back_layers[d][1], features, features, w);
    call.mask = stack.buffer.at(static_cast<std::size_t>(features), element), call.mask_stride = stack.stride;
    call.stored = w.layers.buffer.data(), call.stored_stride = w.layers.stride;
    convolve(*body, w.small, 0, call, w);
    weight_gradient(*body, layers[d][0], {&stack, 0, &w.layers, 0}, w);
    call = back_call(back_layers[d][0], features, features, w);
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    convolve(*body, w.layers, 0, call, w);
  }

  void add_gradients(const std::function<Parameter(const std::string&)>& find) {
    for (std::size_t index = 0; index < convolutions.size(); ++index) {
      const Convolution& c = convolutions[index];
      const std::size_t k = static_cast<std::size_t>(c.inputs), n = static_cast<std::size_t>(c.padded_outputs);
      for (std::size_t other = 1; other < workers.size(); ++other) {
        float* sum = workers[0].gradients[index].taps.floats();
        const float* part = workers[other].gradients[index].taps.floats();
        for (std::size_t i = 0; i < c.size(); ++i) sum[i] += part[i];
        for (std::size_t i = 0; i < n; ++i) {
          workers[0].gradients[index].bias.floats()[i] += workers[other].gradients[index].bias.floats()[i];
        }
      }
      const Gradient& sum = workers[0].gradients[index];
      for_parts(c, [&](const std::string& name, int first, int count) {
        float* weight = find(name + "_weight").gradient;
        for (int o = 0; o < count; ++o) {
          for (const int place : c.places) {
            for (std::size_t t = 0; t < c.taps(); ++t) {
              *weight++ +=
                  sum.taps
                      .floats()[(t * k + static_cast<std::size_t>(place)) * n + static_cast<std::size_t>(first + o)];
            }
          }
        }
        float* bias = find(name + "_bias").gradient;
        for (int o = 0; o < count; ++o) bias[o] += sum.bias.floats()[first + o];
      });
    }
  }
};

bool Trainable::supports(const Architecture& architecture) {
  return (architecture.kind == "mfsr" || architecture.kind == "srresnet") &&
         architecture.features + architecture.layers * architecture.growth <= kLargestOutputs / 2 &&
         architecture.blocks * architecture.features <= kLargestOutputs / 2;
}

Trainable::Trainable(const Architecture& architecture, const TrainableOptions& options)
    : state_(std::make_unique<State>(architecture, options)) {}

Trainable::~Trainable() = default;

const TrainableOptions& Trainable::options() const { return state_->options; }
int Trainable::outputs() const { return state_->outputs(); }

void Trainable::load(const std::function<Parameter(const std::string&)>& find) { state_->load(find); }

void Trainable::forward(const float* input, int count, float* output, bool keep) {
  State& s = *state_;
  const auto needed = static_cast<std::size_t>(keep ? std::max(count, s.team.largest()) : s.team.largest());
  while (s.kept.size() < needed) s.kept.push_back(s.make_kept());
  s.kept_count = keep ? count : 0;
  const std::size_t texels = times(s.g.height, s.g.width);
  s.team.run([&](int member) {
    const int members = s.team.members();
    for (int n = member; n < count; n += members) {
      Kept& kept = s.kept[static_cast<std::size_t>(keep ? n : member)];
      s.forward_image(input + static_cast<std::size_t>(n) * static_cast<std::size_t>(s.options.inputs) * texels, kept,
                      s.workers[static_cast<std::size_t>(member)],
                      output + static_cast<std::size_t>(n) * static_cast<std::size_t>(s.outputs()) * texels);
    }
  });
}

void Trainable::backward(const float* gradient, const std::function<Parameter(const std::string&)>& find) {
  State& s = *state_;
  const std::size_t texels = times(s.g.height, s.g.width);
  s.team.run([&](int member) {
    Worker& worker = s.workers[static_cast<std::size_t>(member)];
    for (std::size_t i = 0; i < s.convolutions.size(); ++i) {
      std::fill_n(worker.gradients[i].taps.floats(), s.convolutions[i].size(), 0.0F);
      std::fill_n(worker.gradients[i].bias.floats(), s.convolutions[i].padded_outputs, 0.0F);
    }
    for (int n = member; n < s.kept_count; n += s.team.members()) {
      s.backward_image(gradient + static_cast<std::size_t>(n) * static_cast<std::size_t>(s.outputs()) * texels,
                       s.kept[static_cast<std::size_t>(n)], worker);
    }
  });
  s.add_gradients(find);
}

}  // namespace pleat::superres::cpu
