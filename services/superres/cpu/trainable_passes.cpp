#include "services/superres/cpu/trainable_passes.hpp"

#include <algorithm>
#include <cstring>

namespace pleat::superres::cpu {
namespace {

/// An odd number of cache lines, so that planes don't fall on each other.
std::size_t plane_of(std::size_t elements, int element) {
  const std::size_t line = 64 / static_cast<std::size_t>(element);
  std::size_t lines = (elements + line - 1) / line;
  lines += 1 - lines % 2;
  return lines * line;
}

/// What both directions need.
class Pass {
 public:
  Pass(const TrainableLayers& layers, Worker& worker)
      : net(layers),
        g(net.g),
        plain(*net.plain),
        body(*net.body),
        element(net.element),
        features(net.features),
        w(worker) {}

 protected:
  const Convolution& convolution(std::size_t index) const { return net.convolutions[index]; }
  std::size_t dense_layer(std::size_t d, int c) const { return net.layers[d][static_cast<std::size_t>(c)]; }
  /// Where the output of layer c of a dense block lies in its stack.
  int slot(int c) const { return features + c * net.growth; }

  ConvolutionCall make_call(const Buffer& weights, const Buffer& bias, int k, int n) const {
    ConvolutionCall call{};
    call.k = k, call.n = n;
    call.weights = weights.data(), call.bias = bias.floats();
    call.scratch = w.scratch.floats();
    return call;
  }

  /// A 3x3 convolution of channels [first, first + call.k) of an image.
  void convolve(const Kernels& kernels, const Features& image, int first, ConvolutionCall call) const {
    kernels.transform(g, {image.buffer.data(), image.stride, first, call.k, w.tiles.data(), call.k, 0, 0}, 0,
                      g.tiles_y);
    call.input = w.tiles.data(), call.input_stride = call.k;
    kernels.convolve3(g, call, 0, g.tiles_y);
  }

  /// Calls use(index of the pixel), row by row.
  template <typename Use>
  void for_pixels(const Use& use) const {
    for (int y = 0; y < g.height; ++y) {
      for (int x = 0; x < g.width; ++x) use(static_cast<std::size_t>((y + 1) * g.row + x + 1));
    }
  }

  /// float32 to elements of the body.
  void narrow(const Features& from, const Features& to, int channels) const {
    for_pixels([&](std::size_t p) { body.store(from.floats(p), to.at(p, 0, element), channels); });
  }

  /// Planes (channels, h, w) to pixels and back.
  void read_planes(const float* planes, int channels, const Features& image) const {
    const std::size_t size = times(g.height, g.width);
    for_pixels([&](std::size_t p) {
      float* target = image.floats(p);
      for (int c = 0; c < channels; ++c) target[c] = planes[static_cast<std::size_t>(c) * size];
      ++planes;
    });
  }
  void write_planes(const Features& image, int channels, float* planes) const {
    const std::size_t size = times(g.height, g.width);
    for_pixels([&](std::size_t p) {
      const float* source = image.floats(p);
      for (int c = 0; c < channels; ++c) planes[static_cast<std::size_t>(c) * size] = source[c];
      ++planes;
    });
  }

  const TrainableLayers& net;
  const Geometry& g;
  const Kernels &plain, &body;
  const int element, features;
  Worker& w;
};

class ForwardPass : Pass {
 public:
  using Pass::Pass;

  void run(const float* input, Kept& k, float* output) const {
    read_planes(input, net.options.inputs, k.input);
    ConvolutionCall call = call_of(net.shallow0);
    call.output = k.shallow.buffer.floats(), call.output_stride = features;
    convolve(plain, k.input, 0, call);
    call = call_of(net.shallow1);
    call.output = w.trunk.buffer.floats(), call.output_stride = features;
    convolve(plain, k.shallow, 0, call);
    for_pixels([&](std::size_t p) { body.store(w.trunk.floats(p), k.stacks[0].at(p, 0, element), features); });
    for (std::size_t d = 0; d < net.layers.size(); ++d) {
      const bool last = d + 1 == net.layers.size();
      if (net.dense) {
        dense_block(d, k, last ? nullptr : &k.stacks[d + 1]);
      } else {
        residual_block(d, k, last ? k.fused : k.stacks[d + 1]);
      }
    }
    if (net.dense) {
      call = call_of(net.global0);
      call.input = k.hierarchy.buffer.data(), call.input_stride = k.hierarchy.stride;
      call.stored = k.fused.buffer.data(), call.stored_stride = features;
      body.convolve1(g, call, 0, g.tiles_y);
    }
    call = call_of(net.global1);
    call.add = k.shallow.buffer.floats(), call.add_stride = features;
    call.stored = k.last.buffer.data(), call.stored_stride = features;
    if (!net.subpixel) call.output = w.answer32.buffer.floats(), call.output_stride = w.answer32.stride;
    convolve(body, k.fused, 0, call);
    if (net.subpixel) {
      call = call_of(net.heads);
      call.output = w.answer32.buffer.floats(), call.output_stride = w.answer32.stride;
      convolve(body, k.last, 0, call);
    }
    write_planes(w.answer32, net.outputs(), output);
  }

 private:
  ConvolutionCall call_of(std::size_t index) const {
    const Convolution& c = convolution(index);
    return make_call(c.weights, c.bias, c.inputs, c.padded_outputs);
  }

  /// next: the stack of the next block, or null.
  void dense_block(std::size_t d, Kept& k, const Features* next) const {
    const Features& stack = k.stacks[d];
    ConvolutionCall call{};
    for (int c = 0; c < net.a.layers; ++c) {
      const int from = c == 0 ? 0 : slot(c - 1), count = c == 0 ? features : net.growth;
      body.transform(g, {stack.buffer.data(), stack.stride, from, count, w.tiles.data(), stack.stride, from, 0}, 0,
                     g.tiles_y);
      call = call_of(dense_layer(d, c));
      call.input = w.tiles.data(), call.input_stride = stack.stride;
      call.slope = net.zero_slope.floats();
      call.stored = stack.at(0, slot(c), element), call.stored_stride = stack.stride;
      body.convolve3(g, call, 0, g.tiles_y);
    }
    call = call_of(net.fusions[d]);
    call.input = stack.buffer.data(), call.input_stride = stack.stride;
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = k.hierarchy.at(0, static_cast<int>(d) * features, element);
    call.stored_stride = k.hierarchy.stride;
    if (next != nullptr) call.also_stored = next->buffer.data(), call.also_stored_stride = next->stride;
    body.convolve1(g, call, 0, g.tiles_y);
  }

  /// next: the stack of the next block, or what global1 reads.
  void residual_block(std::size_t d, Kept& k, const Features& next) const {
    const Features& stack = k.stacks[d];
    ConvolutionCall call = call_of(net.layers[d][0]);
    call.slope = net.zero_slope.floats();
    call.stored = stack.at(0, features, element), call.stored_stride = stack.stride;
    convolve(body, stack, 0, call);
    call = call_of(net.layers[d][1]);
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = next.buffer.data(), call.stored_stride = next.stride;
    convolve(body, stack, features, call);
  }
};

class BackwardPass : Pass {
 public:
  using Pass::Pass;

  void run(const float* gradient, const Kept& k) const {
    read_planes(gradient, net.outputs(), w.answer32);
    // Gradient of `last`, in w.small; that of `shallow` begins with the same.
    if (net.subpixel) {
      const int channels = convolution(net.heads).padded_outputs;
      narrow(w.answer32, w.answer, channels);
      weight_gradient(body, net.heads, k.last, 0, w.answer);
      ConvolutionCall call = call_of(net.back_heads, channels, features);
      call.output = w.shallow_gradient.buffer.floats(), call.output_stride = features;
      call.stored = w.small.buffer.data(), call.stored_stride = features;
      convolve(body, w.answer, 0, call);
    } else {
      for_pixels([&](std::size_t p) { std::copy_n(w.answer32.floats(p), features, w.shallow_gradient.floats(p)); });
      narrow(w.shallow_gradient, w.small, features);
    }
    weight_gradient(body, net.global1, k.fused, 0, w.small);
    ConvolutionCall call = call_of(net.back_global1, features, features);
    call.output = w.trunk.buffer.floats(), call.output_stride = features;
    convolve(body, w.small, 0, call);
    if (net.dense) {
      narrow(w.trunk, w.small, features);
      weight_gradient(body, net.global0, k.hierarchy, 0, w.small);
      call = call_of(net.back_global0, features, net.a.blocks * features);
      call.input = w.small.buffer.data(), call.input_stride = features;
      call.output = w.hierarchy_gradient.buffer.floats(), call.output_stride = w.hierarchy_gradient.stride;
      body.convolve1(g, call, 0, g.tiles_y);
      const int last = (net.a.blocks - 1) * features;
      for_pixels(
          [&](std::size_t p) { std::copy_n(w.hierarchy_gradient.floats(p, last), features, w.trunk.floats(p)); });
    }
    for (std::size_t d = net.layers.size(); d-- > 0;) {
      if (net.dense) {
        dense_block(d, k.stacks[d]);
      } else {
        residual_block(d, k.stacks[d]);
      }
    }
    // w.trunk is the gradient of shallow1's output.
    weight_gradient(plain, net.shallow1, k.shallow, 0, w.trunk);
    call = call_of(net.back_shallow1, features, features);
    call.add = call.output = w.shallow_gradient.buffer.floats();
    call.add_stride = call.output_stride = features;
    convolve(plain, w.trunk, 0, call);
    weight_gradient(plain, net.shallow0, k.input, 0, w.shallow_gradient);
  }

 private:
  ConvolutionCall call_of(const Buffer& weights, int k, int n) const { return make_call(weights, net.no_bias, k, n); }

  /// From the gradient of a block's output to that of its input, both in w.trunk.
  void dense_block(std::size_t d, const Features& stack) const {
    narrow(w.trunk, w.small, features);
    weight_gradient(body, net.fusions[d], stack, 0, w.small);
    ConvolutionCall call = call_of(net.back_fusions[d], features, net.stack_channels());
    call.input = w.small.buffer.data(), call.input_stride = features;
    call.output = w.stack_gradient.buffer.floats(), call.output_stride = w.stack_gradient.stride;
    body.convolve1(g, call, 0, g.tiles_y);
    dense_outputs(d, stack);

    // f: by the skip, the fusion, all layers, and as the output of the block before.
    for_pixels([&](std::size_t p) {
      float* sum = w.trunk.floats(p);
      const float* own = w.stack_gradient.floats(p);
      for (int i = 0; i < features; ++i) sum[i] += own[i];
      if (d > 0) {
        const float* other = w.hierarchy_gradient.floats(p, (static_cast<int>(d) - 1) * features);
        for (int i = 0; i < features; ++i) sum[i] += other[i];
      }
    });
    const int width = net.a.layers * net.growth;
    call = call_of(net.back_layers[d][0], width, features);
    call.input = w.tiles.data(), call.input_stride = width;
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    body.convolve3(g, call, 0, g.tiles_y);
    dense_weights(d, stack);
  }

  /// Gradients of the layers' outputs, from the last to the first: each gets what the fusion and the later layers want
  /// of it. In w.layers, and transformed in w.tiles.
  void dense_outputs(std::size_t d, const Features& stack) const {
    const int growth = net.growth, width = net.a.layers * growth;
    for (int c = net.a.layers - 1; c >= 0; --c) {
      const int place = c * growth;
      if (c == net.a.layers - 1) {
        for_pixels([&](std::size_t p) {
          body.store_masked(w.stack_gradient.floats(p, slot(c)), stack.at(p, slot(c), element),
                            w.layers.at(p, place, element), growth);
        });
      } else {
        const Buffer& weights = net.back_layers[d][static_cast<std::size_t>(c + 1)];
        ConvolutionCall call = call_of(weights, (net.a.layers - 1 - c) * growth, growth);
        call.input = w.tiles.at(static_cast<std::size_t>(place + growth), element), call.input_stride = width;
        call.add = w.stack_gradient.floats(0, slot(c)), call.add_stride = w.stack_gradient.stride;
        call.mask = stack.at(0, slot(c), element), call.mask_stride = stack.stride;
        call.stored = w.layers.at(0, place, element), call.stored_stride = w.layers.stride;
        body.convolve3(g, call, 0, g.tiles_y);
      }
      body.transform(g, {w.layers.buffer.data(), w.layers.stride, place, growth, w.tiles.data(), width, place, 0}, 0,
                     g.tiles_y);
    }
  }

  /// Weights of all layers from one grouping of both sides.
  void dense_weights(std::size_t d, const Features& stack) const {
    const int width = net.a.layers * net.growth, read = slot(net.a.layers - 1);
    const int groups = groups_of(body, g.tiles());
    const std::size_t read_plane = plane(body, groups, read), width_plane = plane(body, groups, width);
    body.group_inputs(g, {stack.buffer.data(), stack.stride, 0, read, w.input_groups.data(), read_plane, read, 0});
    body.group_outputs(
        g, {w.layers.buffer.data(), w.layers.stride, 0, width, w.output_groups.data(), width_plane, width, 0});
    for (int c = 0; c < net.a.layers; ++c) {
      const auto first = static_cast<std::size_t>(c * net.growth * body.group);
      correlate(
          body, dense_layer(d, c),
          {w.input_groups.data(), read_plane, read, w.output_groups.at(first, element), width_plane, width, groups});
      bias_gradient(body, dense_layer(d, c), w.layers, c * net.growth);
    }
  }

  void residual_block(std::size_t d, const Features& stack) const {
    narrow(w.trunk, w.small, features);
    weight_gradient(body, net.layers[d][1], stack, features, w.small);
    ConvolutionCall call = call_of(net.back_layers[d][1], features, features);
    call.mask = stack.at(0, features, element), call.mask_stride = stack.stride;
    call.stored = w.layers.buffer.data(), call.stored_stride = w.layers.stride;
    convolve(body, w.small, 0, call);
    weight_gradient(body, net.layers[d][0], stack, 0, w.layers);
    call = call_of(net.back_layers[d][0], features, features);
    call.add = call.output = w.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    convolve(body, w.layers, 0, call);
  }

  /// Groups of tiles or pixels.
  static int groups_of(const Kernels& kernels, std::size_t members) {
    const auto group = static_cast<std::size_t>(kernels.group);
    return static_cast<int>((members + group - 1) / group);
  }
  static std::size_t plane(const Kernels& kernels, int groups, int channels) {
    return plane_of(times(groups, channels) * static_cast<std::size_t>(kernels.group), kernels.element);
  }

  /// Adds the gradient of a convolution's weights and bias: of its inputs, from channel `first` on, and the gradient of
  /// its outputs. Both images in elements of the kernels.
  void weight_gradient(const Kernels& kernels, std::size_t index, const Features& inputs, int first,
                       const Features& outputs) const {
    const Convolution& c = convolution(index);
    const bool three = c.kernel == 3;
    const int groups = groups_of(kernels, three ? g.tiles() : times(g.height, g.width));
    const std::size_t a_plane = plane(kernels, groups, c.inputs), b_plane = plane(kernels, groups, c.padded_outputs);
    const auto group_in = three ? kernels.group_inputs : kernels.group_pixels;
    const auto group_out = three ? kernels.group_outputs : kernels.group_pixels;
    group_in(g, {inputs.buffer.data(), inputs.stride, first, c.inputs, w.input_groups.data(), a_plane, c.inputs, 0});
    group_out(g, {outputs.buffer.data(), outputs.stride, 0, c.padded_outputs, w.output_groups.data(), b_plane,
                  c.padded_outputs, 0});
    correlate(kernels, index,
              {w.input_groups.data(), a_plane, c.inputs, w.output_groups.data(), b_plane, c.padded_outputs, groups});
    bias_gradient(kernels, index, outputs, 0);
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
  void correlate(const Kernels& kernels, std::size_t index, const Groups& groups) const {
    const Convolution& c = convolution(index);
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

  void bias_gradient(const Kernels& kernels, std::size_t index, const Features& outputs, int first) const {
    const int channels = convolution(index).padded_outputs;
    float* sums = w.gradients[index].bias.floats();
    for_pixels([&](std::size_t p) {
      if (kernels.element == 4) {
        const float* values = outputs.floats(p, first);
        for (int c = 0; c < channels; ++c) sums[c] += values[c];
        return;
      }
      const auto* halves = static_cast<const std::uint16_t*>(outputs.at(p, first, kernels.element));
      for (int c = 0; c < channels; ++c) {
        const std::uint32_t bits = static_cast<std::uint32_t>(halves[c]) << 16;
        float value;
        std::memcpy(&value, &bits, sizeof value);
        sums[c] += value;
      }
    });
  }
};

}  // namespace

Kept::Kept(const TrainableLayers& net)
    : input(net.g, net.inputs, 4),
      shallow(net.g, net.features, 4),
      fused(net.g, net.features, net.element),
      last(net.g, net.features, net.element) {
  for (int d = 0; d < net.a.blocks; ++d) stacks.emplace_back(net.g, net.stack_channels(), net.element);
  if (net.dense) hierarchy = Features(net.g, net.a.blocks * net.features, net.element);
}

Worker::Worker(const TrainableLayers& net)
    : trunk(net.g, net.features, 4),
      stack_gradient(net.g, net.stack_channels(), 4),
      hierarchy_gradient(net.g, net.dense ? net.a.blocks * net.features : 16, 4),
      shallow_gradient(net.g, net.features, 4),
      small(net.g, net.features, net.element),
      layers(net.g, std::max(net.dense ? net.a.layers * net.growth : net.features, net.features), net.element) {
  const int answers = net.subpixel ? net.convolutions[net.heads].padded_outputs : net.features;
  answer = Features(net.g, answers, net.element);
  answer32 = Features(net.g, answers, 4);
  // Elements of four bytes: the shallow convolutions use the same buffers.
  const int widest = std::max({net.stack_channels(), net.inputs, answers});
  tiles = Buffer(net.g.tiles() * kPoints * times(widest, 4));
  const int lists = std::max(widest, net.a.blocks * net.features);
  const std::size_t members =
      std::max(net.g.tiles() + 1, (times(net.g.height, net.g.width) + kPoints) / kPoints + 1) * kPoints;
  input_groups = Buffer((members * static_cast<std::size_t>(lists) + 64 * kPoints) * 4);
  output_groups = Buffer((members * static_cast<std::size_t>(lists) + 64 * kPoints) * 4);
  std::size_t largest = 0;
  for (const Convolution& c : net.convolutions) {
    largest = std::max(largest, (c.kernel == 3 ? kPoints : 1) * times(c.inputs, c.padded_outputs));
    gradients.push_back({Buffer(c.size() * sizeof(float)), Buffer(times(c.padded_outputs, 4))});
  }
  sums = Buffer(largest * sizeof(float));
  scratch = Buffer(kScratch * sizeof(float));
}

void forward_image(const TrainableLayers& net, const float* input, Kept& kept, Worker& worker, float* output) {
  ForwardPass(net, worker).run(input, kept, output);
}

void backward_image(const TrainableLayers& net, const float* gradient, const Kept& kept, Worker& worker) {
  BackwardPass(net, worker).run(gradient, kept);
}

}  // namespace pleat::superres::cpu
