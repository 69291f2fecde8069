#include "services/superres/cpu/executor.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <numeric>
#include <optional>

#include "common/base/error.hpp"
#include "services/superres/cpu/team.hpp"
#include "services/superres/cpu/texels.hpp"
#include "services/superres/cpu/weights.hpp"
#include "services/superres/mesh_base.hpp"

namespace pleat::superres::cpu {
namespace {

/// Transformed tiles of a 3x3 convolution outside the dense blocks: few enough to stay in the processor's cache.
constexpr std::size_t kStripBytes = 256 << 10;

/// Which is faster lately: one thread or all.
class Pace {
 public:
  /// For the next image.
  bool alone() {
    if (turn_ < 2) return turn_++ == 1;  // each once, to begin with
    const bool better = alone_ms_ < together_ms_;
    return ++turn_ % kTry == 0 ? !better : better;
  }
  void took(bool alone, double ms) {
    double& known = alone ? alone_ms_ : together_ms_;
    known = known > 0 ? known + kMemory * (ms - known) : ms;
  }

 private:
  static constexpr int kTry = 24;  ///< images between two trials of what is slower
  static constexpr double kMemory = 0.3;
  int turn_ = 0;
  double alone_ms_ = 0, together_ms_ = 0;
};

const Array& find(const Arrays& arrays, const std::string& name) {
  const auto it = arrays.find(name);
  if (it == arrays.end()) throw_invalid_argument("network: no array " + name);
  return it->second;
}

std::vector<int> range(int begin, int count) {
  std::vector<int> places(static_cast<std::size_t>(count));
  std::iota(places.begin(), places.end(), begin);
  return places;
}

/// The part of a convolution's weight that reads inputs [begin, end).
std::vector<float> inputs_of(const Array& weight, std::int64_t begin, std::int64_t end) {
  const std::int64_t taps = weight.shape[2] * weight.shape[3], inputs = weight.shape[1];
  std::vector<float> part;
  for (std::int64_t o = 0; o < weight.shape[0]; ++o) {
    const auto first = weight.values.begin() + o * inputs * taps;
    part.insert(part.end(), first + begin * taps, first + end * taps);
  }
  return part;
}

/// Features of one size: `stride` channels a pixel.
struct Image {
  Buffer buffer;
  int stride = 0;
  Image() = default;
  Image(const Geometry& geometry, int channels, int element)
      : buffer(geometry.pixels() * static_cast<std::size_t>(channels) * static_cast<std::size_t>(element)),
        stride(channels) {}
};

/// Everything that depends on the size of the image.
struct Plan {
  Geometry coarse, fine;
  Image input, shallow, trunk;          ///< float32
  Image structure;                      ///< float32: what the constant structure channels add to the first convolution
  Image stack, hierarchy, fused, last;  ///< elements
  Image upsampled;                      ///< elements, fine size
  Image answer;                         ///< float32: coarse size, 16 values a channel; or fine size
  Buffer tiles;                         ///< transformed features of a dense block
  std::vector<Buffer> strips, scratch;  ///< one a member
  std::vector<float> axes;
  std::vector<float> vertex_values;
  std::optional<LocalFeatures> local;
  std::optional<UpsampledMesh> mesh;
};

}  // namespace

struct Executor::State {
  Architecture a;
  const Kernels* plain;  ///< float32: the shallow convolutions
  const Kernels* body;
  int element;
  Team team;
  Pace pace;

  int features, growth;  ///< padded to whole vectors
  int inputs = 0;        ///< of the first convolution, without the structure
  Weights shallow0, shallow1, global0, global1, heads, heads_displacement;
  std::vector<float> structure_weight, structure_values;
  std::vector<std::vector<Weights>> layers;  ///< of a block
  std::vector<Weights> fusions;
  Buffer zeros;  ///< slope of ReLU
  std::vector<float> input_mean, input_scale, detail_scale, output_scale;
  Normalization normalization;
  const Arrays* arrays = nullptr;  ///< during construction only
  // Constants of residual "mesh", kept for a plan.
  std::vector<float> rest, local_mean, local_deviation, vertex_weights, corner_weights;
  std::vector<std::int64_t> vertex_texels, corners;
  std::size_t vertices = 0;

  Plan plan;
  int height = 0, width = 0;

  State(const Architecture& architecture, const Arrays& values, const ExecutorOptions& options)
      : a(architecture),
        plain(&float32_kernels(options.base_instructions)),
        body(plain),
        element(4),
        team(options.threads) {
    arrays = &values;
    if (options.bfloat16) body = &bfloat16_kernels();
    element = body->element;
    features = round_up(a.features, body->lanes);
    growth = round_up(a.growth, body->lanes);
    zeros = Buffer(static_cast<std::size_t>(std::max(features, growth)) * sizeof(float));
    read_constants();
    pack();
    arrays = nullptr;
  }

  const Array& array(const std::string& name, const std::vector<std::int64_t>& shape) const {
    const Array& found = find(*arrays, name);
    if (found.shape != shape) throw_invalid_argument("network: array " + name + " has another shape");
    return found;
  }
  std::vector<float> channel_values(const std::string& name, std::int64_t count) const {
    return array(name, {1, count, 1, 1}).values;
  }

  void read_constants() {
    if (a.conditioned) {
      input_mean = channel_values("input_mean", kChannels);
      input_scale = channel_values("input_deviation", kChannels);
      detail_scale = channel_values("detail_deviation", kChannels);
      output_scale = channel_values("output_deviation", kChannels);
      for (float& v : input_scale) v = 1 / v;
      for (float& v : detail_scale) v = 1 / v;
    }
    if (a.residual == "mesh") {
      const auto minimum = channel_values("base_minimum", kChannels), span = channel_values("base_range", kChannels);
      for (std::size_t c = 0; c < kChannels; ++c) {
        normalization.minimum[c] = minimum[c];
        normalization.maximum[c] = minimum[c] + span[c];
      }
      const Array& structure = find(*arrays, "base_structure");
      height = static_cast<int>(structure.shape.at(2)), width = static_cast<int>(structure.shape.at(3));
      structure_values = structure.values;
      rest = array("base_rest", {1, 3, height, width}).values;
      const std::int64_t fine = std::int64_t{16} * height * width;
      corners = array("base_corners", {3, fine}).indices;
      corner_weights = array("base_weights", {3, fine}).values;
      const Array& texels = find(*arrays, "base_vertex_texels");
      vertex_texels = texels.indices;
      vertex_weights = array("base_vertex_weights", texels.shape).values;
      vertices = static_cast<std::size_t>(texels.shape.at(0));
    }
    if (a.axes == "local") {
      local_mean = channel_values("local_mean", kLocalChannels);
      local_deviation = channel_values("local_deviation", kLocalChannels);
      output_scale = channel_values("local_output", kChannels);
    }
  }

  Weights convolution(const Kernels& kernels, const std::string& name, int kernel, std::span<const int> places,
                      int k) const {
    const Array& weight = find(*arrays, name + "_weight");
    const auto inputs_here = static_cast<std::int64_t>(places.size());
    if (weight.shape.size() != 4 || weight.shape[1] != inputs_here || weight.shape[2] != kernel) {
      throw_invalid_argument("network: array " + name + "_weight has another shape");
    }
    const Array& bias = array(name + "_bias", {weight.shape[0]});
    return pack_weights(kernels, weight.values, bias.values, kernel, places, k);
  }

  void pack() {
    inputs = a.axes == "local" ? kLocalChannels : a.conditioned ? 2 * kChannels : kChannels;
    const Array& first = find(*arrays, "shallow0_weight");
    const int structure_inputs = a.residual == "mesh" ? kStructureChannels : 0;
    if (first.shape != std::vector<std::int64_t>{a.features, inputs + structure_inputs, 3, 3}) {
      throw_invalid_argument("network: array shallow0_weight has another shape");
    }
    structure_weight = inputs_of(first, inputs, inputs + structure_inputs);
    shallow0 = pack_weights(*plain, inputs_of(first, 0, inputs), array("shallow0_bias", {a.features}).values, 3,
                            range(0, inputs), round_up(inputs, 2));
    shallow1 = convolution(*plain, "shallow1", 3, range(0, a.features), features);
    std::vector<int> hierarchy;
    for (int d = 0; d < a.blocks; ++d) {
      const std::string block = "block" + std::to_string(d);
      auto& list = layers.emplace_back();
      if (a.kind == "srresnet") {
        list.push_back(convolution(*body, block + "_first", 3, range(0, a.features), features));
        list.push_back(convolution(*body, block + "_second", 3, range(0, a.features), features));
        continue;
      }
      auto places = range(0, a.features);
      for (int c = 0; c < a.layers; ++c) {
        const int k = features + c * growth;
        list.push_back(convolution(*body, block + "_dense" + std::to_string(c), 3, places, k));
        const auto more = range(k, a.growth);
        places.insert(places.end(), more.begin(), more.end());
      }
      fusions.push_back(convolution(*body, block + "_fusion", 1, places, features + a.layers * growth));
      const auto own = range(d * features, a.features);
      hierarchy.insert(hierarchy.end(), own.begin(), own.end());
    }
    if (a.kind == "mfsr") global0 = convolution(*body, "global0", 1, hierarchy, a.blocks * features);
    global1 = convolution(*body, "global1", 3, range(0, a.features), features);
    const Array& weight = find(*arrays, "heads_weight");
    const std::int64_t outputs = a.upsampling == "subpixel" ? kChannels * kScale * kScale : kChannels;
    const Array& bias = array("heads_bias", {outputs});
    heads = convolution(*body, "heads", 3, range(0, a.features), features);
    const auto third = static_cast<std::ptrdiff_t>(outputs / 3);
    const std::vector<float> few(weight.values.begin(),
                                 weight.values.begin() + static_cast<std::ptrdiff_t>(weight.values.size() / 3));
    heads_displacement =
        pack_weights(*body, few, {bias.values.begin(), bias.values.begin() + third}, 3, range(0, a.features), features);
  }

  void make_plan(int h, int w) {
    plan = Plan{};
    Plan& p = plan;
    p.coarse = Geometry(h, w);
    const int members = team.largest();
    p.input = Image(p.coarse, round_up(inputs, plain->lanes), 4);
    p.shallow = Image(p.coarse, features, 4);
    p.trunk = Image(p.coarse, features, 4);
    const bool dense = a.kind == "mfsr";
    p.stack = Image(p.coarse, features + (dense ? a.layers * growth : 0), element);
    p.fused = Image(p.coarse, features, element);
    p.last = Image(p.coarse, features, element);
    const auto widest = static_cast<std::size_t>(std::max({p.input.stride, features, kStructureChannels}));
    if (dense) {
      p.hierarchy = Image(p.coarse, a.blocks * features, element);
      p.tiles = Buffer(p.coarse.tiles() * kPoints * static_cast<std::size_t>(p.stack.stride) *
                       static_cast<std::size_t>(element));
    }
    const bool subpixel = a.upsampling == "subpixel";
    if (!subpixel) {
      p.fine = Geometry(kScale * h, kScale * w);
      p.upsampled = Image(p.fine, features, element);
    }
    p.answer = subpixel ? Image(p.coarse, heads.n, 4) : Image(p.fine, heads.n, 4);
    const auto row_of = [&](const Geometry& g) {
      return static_cast<std::size_t>(g.tiles_x) * kPoints * widest * sizeof(float);
    };
    for (int m = 0; m < members; ++m) {
      p.strips.emplace_back(std::max(kStripBytes, row_of(subpixel ? p.coarse : p.fine)));
      p.scratch.emplace_back(kScratch * sizeof(float));
    }
    if (a.axes == "local") {
      p.local.emplace(normalization, rest, h, w, local_mean, local_deviation);
      p.axes.resize(static_cast<std::size_t>(9 * h * w));
    }
    if (a.residual == "mesh") {
      p.mesh.emplace(vertex_texels, vertex_weights, vertices, corners, corner_weights, h, w);
      p.vertex_values.resize(vertices * kChannels);
      add_structure();
    }
    height = h, width = w;
  }

  /// The structure channels are the same in every frame: their part of the first convolution is an image.
  void add_structure() {
    Plan& p = plan;
    p.structure = Image(p.coarse, features, 4);
    Image image(p.coarse, kStructureChannels, 4);
    const auto h = static_cast<std::size_t>(p.coarse.height), w = static_cast<std::size_t>(p.coarse.width);
    for (std::size_t c = 0; c < kStructureChannels; ++c) {
      for (std::size_t y = 0; y < h; ++y) {
        for (std::size_t x = 0; x < w; ++x) {
          image.buffer.floats()[((y + 1) * static_cast<std::size_t>(p.coarse.row) + x + 1) * kStructureChannels + c] =
              structure_values[(c * h + y) * w + x];
        }
      }
    }
    const Weights weights =
        pack_weights(*plain, structure_weight, {}, 3, range(0, kStructureChannels), kStructureChannels);
    ConvolutionCall call = call_of(weights);
    call.output = p.structure.buffer.floats(), call.output_stride = features;
    convolve_strips(*plain, p.coarse, image, call, 0, 0, p.coarse.tiles_y);
  }

  static ConvolutionCall call_of(const Weights& weights) {
    ConvolutionCall call{};
    call.k = weights.k, call.n = weights.n;
    call.weights = weights.weights.data();
    call.bias = weights.bias.floats();
    return call;
  }

  /// A 3x3 convolution of an image, a few tile rows at a time.
  void convolve_strips(const Kernels& kernels, const Geometry& g, const Image& image, ConvolutionCall call, int member,
                       int begin, int end) {
    const int channels = round_up(call.k, kernels.lanes);
    const std::size_t row = static_cast<std::size_t>(g.tiles_x) * kPoints * static_cast<std::size_t>(channels) *
                            static_cast<std::size_t>(kernels.element);
    const int rows = std::max(1, static_cast<int>(kStripBytes / row));
    const auto m = static_cast<std::size_t>(member);
    TransformCall transform{image.buffer.data(), image.stride, 0, channels, plan.strips[m].data(), channels, 0, 0};
    call.input = plan.strips[m].data();
    call.input_stride = channels;
    call.scratch = plan.scratch[m].floats();
    for (int first = begin; first < end; first += rows) {
      const int last = std::min(first + rows, end);
      transform.origin = call.origin = first;
      kernels.transform(g, transform, first, last);
      kernels.convolve3(g, call, first, last);
    }
  }

  void read_input(const Planes& image, int begin, int end) {
    Plan& p = plan;
    float* features_in = p.input.buffer.floats();
    if (a.axes == "local") {
      p.local->compute(image, begin, end, features_in, p.coarse.row, p.input.stride, p.axes.data());
      return;
    }
    for (int c = 0; c < kChannels; ++c) {
      const auto i = static_cast<std::size_t>(c);
      const float* plane = image.row(c, 0);
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < image.width; ++x) {
          float* target =
              features_in + (static_cast<std::ptrdiff_t>(y + 1) * p.coarse.row + x + 1) * p.input.stride + c;
          const float value = plane[y * image.width + x];
          if (!a.conditioned) {
            *target = value;
            continue;
          }
          // The local detail: the value minus its 7x7 mean inside the image.
          float sum = 0;
          const int top = std::max(y - 3, 0), bottom = std::min(y + 3, image.height - 1);
          const int left = std::max(x - 3, 0), right = std::min(x + 3, image.width - 1);
          for (int yy = top; yy <= bottom; ++yy) {
            for (int xx = left; xx <= right; ++xx) sum += plane[yy * image.width + xx];
          }
          const float mean = sum / static_cast<float>((bottom - top + 1) * (right - left + 1));
          target[0] = (value - input_mean[i]) * input_scale[i];
          target[kChannels] = (value - mean) * detail_scale[i];
        }
      }
    }
  }

  void dense_block(int d, int member, int begin, int end) {
    Plan& p = plan;
    const auto block = static_cast<std::size_t>(d);
    ConvolutionCall call{};
    for (int c = 0; c < a.layers; ++c) {
      // What the last layer, or the last block, made.
      const int from = c == 0 ? 0 : features + (c - 1) * growth;
      body->transform(p.coarse,
                      {p.stack.buffer.data(), p.stack.stride, from, c == 0 ? features : growth, p.tiles.data(),
                       p.stack.stride, from, 0},
                      begin, end);
      call = call_of(layers[block][static_cast<std::size_t>(c)]);
      call.input = p.tiles.data(), call.input_stride = p.stack.stride;
      call.slope = zeros.floats();
      call.stored = p.stack.buffer.at(static_cast<std::size_t>(features + c * growth), element);
      call.stored_stride = p.stack.stride;
      call.scratch = p.scratch[static_cast<std::size_t>(member)].floats();
      body->convolve3(p.coarse, call, begin, end);
      // The fusion overwrites what the first layer of another thread may still read.
      if (c + 1 < a.layers || c == 0) team.barrier();
    }
    call = call_of(fusions[block]);
    call.input = p.stack.buffer.data(), call.input_stride = p.stack.stride;
    call.add = call.output = p.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = p.hierarchy.buffer.at(block * static_cast<std::size_t>(features), element);
    call.stored_stride = p.hierarchy.stride;
    call.also_stored = p.stack.buffer.data(), call.also_stored_stride = p.stack.stride;
    call.scratch = p.scratch[static_cast<std::size_t>(member)].floats();
    body->convolve1(p.coarse, call, begin, end);
  }

  void residual_block(int d, int member, int begin, int end) {
    Plan& p = plan;
    const auto block = static_cast<std::size_t>(d);
    Image& inner = p.fused;
    ConvolutionCall call = call_of(layers[block][0]);
    call.slope = zeros.floats();
    call.stored = inner.buffer.data(), call.stored_stride = features;
    convolve_strips(*body, p.coarse, p.stack, call, member, begin, end);
    team.barrier();
    call = call_of(layers[block][1]);
    call.add = call.output = p.trunk.buffer.floats();
    call.add_stride = call.output_stride = features;
    call.stored = p.stack.buffer.data(), call.stored_stride = p.stack.stride;
    convolve_strips(*body, p.coarse, inner, call, member, begin, end);
  }

  void run_member(int member, const Planes& image, int channels, float* output) {
    Plan& p = plan;
    const int members = team.members(), tile_rows = p.coarse.tiles_y;
    const int begin = tile_rows * member / members, end = tile_rows * (member + 1) / members;
    const int first_row = begin * kTile, last_row = std::min(end * kTile, image.height);
    const auto m = static_cast<std::size_t>(member), all = static_cast<std::size_t>(members);
    read_input(image, first_row, last_row);
    if (p.mesh) {
      p.mesh->vertex_values(image, channels, vertices * m / all, vertices * (m + 1) / all, p.vertex_values.data());
    }
    team.barrier();

    ConvolutionCall call = call_of(shallow0);
    if (p.mesh) call.add = p.structure.buffer.floats(), call.add_stride = features;
    call.output = p.shallow.buffer.floats(), call.output_stride = features;
    convolve_strips(*plain, p.coarse, p.input, call, member, begin, end);
    team.barrier();
    call = call_of(shallow1);
    call.output = p.trunk.buffer.floats(), call.output_stride = features;
    convolve_strips(*plain, p.coarse, p.shallow, call, member, begin, end);
    store_trunk(first_row, last_row);
    for (int d = 0; d < a.blocks; ++d) {
      team.barrier();
      if (a.kind == "srresnet") {
        residual_block(d, member, begin, end);
      } else {
        dense_block(d, member, begin, end);
      }
    }
    const Image* deep = &p.stack;
    if (a.kind == "mfsr") {
      call = call_of(global0);
      call.input = p.hierarchy.buffer.data(), call.input_stride = p.hierarchy.stride;
      call.stored = p.fused.buffer.data(), call.stored_stride = features;
      call.scratch = p.scratch[m].floats();
      body->convolve1(p.coarse, call, begin, end);
      deep = &p.fused;
    }
    team.barrier();
    const bool subpixel = a.upsampling == "subpixel";
    call = call_of(global1);
    call.add = p.shallow.buffer.floats(), call.add_stride = features;
    call.stored = p.last.buffer.data(), call.stored_stride = features;
    // The trunk is free by now, and bilinear upsampling reads float32.
    call.output = subpixel ? nullptr : p.trunk.buffer.floats(), call.output_stride = features;
    convolve_strips(*body, p.coarse, *deep, call, member, begin, end);
    team.barrier();

    call = call_of(channels == 3 ? heads_displacement : heads);
    call.output = p.answer.buffer.floats(), call.output_stride = p.answer.stride;
    if (subpixel) {
      convolve_strips(*body, p.coarse, p.last, call, member, begin, end);
    } else {
      upsample_features(member, begin, end);
      team.barrier();
      convolve_strips(*body, p.fine, p.upsampled, call, member, begin * kScale, std::min(end * kScale, p.fine.tiles_y));
    }
    finish(image, channels, first_row, last_row, output);
  }

  /// The trunk as elements, in the first channels of the stack.
  void store_trunk(int begin, int end) const {
    const Plan& p = plan;
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < p.coarse.width; ++x) {
        const auto pixel = static_cast<std::size_t>((y + 1) * p.coarse.row + x + 1);
        body->store(p.trunk.buffer.floats() + pixel * static_cast<std::size_t>(features),
                    p.stack.buffer.at(pixel * static_cast<std::size_t>(p.stack.stride), element), features);
      }
    }
  }

  /// Bilinear upsampling of the trunk, and the fine image of features in elements.
  void upsample_features(int member, int begin, int end) {
    Plan& p = plan;
    const int h = p.coarse.height, w = p.coarse.width;
    float* line = p.scratch[static_cast<std::size_t>(member)].floats();
    const int last = std::min(end * kTile, h) * kScale;
    const auto place = [](int i, int size, int& low, int& high, float& t) {
      const float position = std::max(0.0F, (static_cast<float>(i) + 0.5F) / kScale - 0.5F);
      low = static_cast<int>(position);
      high = std::min(low + 1, size - 1);
      t = position - static_cast<float>(low);
    };
    const auto pixel = [&](int y, int x) {
      return p.trunk.buffer.floats() + (static_cast<std::ptrdiff_t>(y + 1) * p.coarse.row + x + 1) * features;
    };
    // One row of the result at a time, as a geometry of its own whose first pixel is `line`.
    const int piece = std::max(1, static_cast<int>(kScratch) / features);
    for (int y = begin * kTile * kScale; y < last; ++y) {
      int y0 = 0, y1 = 0, x0 = 0, x1 = 0;
      float ty = 0, tx = 0;
      place(y, h, y0, y1, ty);
      for (int first = 0; first < kScale * w; first += piece) {
        const int count = std::min(piece, kScale * w - first);
        for (int x = 0; x < count; ++x) {
          place(first + x, w, x0, x1, tx);
          const float *a00 = pixel(y0, x0), *a01 = pixel(y0, x1), *a10 = pixel(y1, x0), *a11 = pixel(y1, x1);
          float* target = line + static_cast<std::ptrdiff_t>(x) * features;
          for (int c = 0; c < features; ++c) {
            target[c] = (1 - ty) * ((1 - tx) * a00[c] + tx * a01[c]) + ty * ((1 - tx) * a10[c] + tx * a11[c]);
          }
        }
        body->store(line,
                    p.upsampled.buffer.at(((static_cast<std::size_t>(y) + 1) * static_cast<std::size_t>(p.fine.row) +
                                           static_cast<std::size_t>(first) + 1) *
                                              static_cast<std::size_t>(features),
                                          element),
                    count * features);
      }
    }
  }

  /// The heads' answer in the units of the image, plus what it is added to, for coarse rows [begin, end).
  void finish(const Planes& image, int channels, int begin, int end, float* output) {
    Plan& p = plan;
    const int w = image.width, fine_width = kScale * w;
    const bool subpixel = a.upsampling == "subpixel";
    const std::ptrdiff_t plane = std::ptrdiff_t{kScale * kScale} * image.height * w;
    Block blocks[kChannels], axes[9], base;
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < w; ++x) {
        const auto texel = static_cast<std::size_t>(y * w + x);
        for (int c = 0; c < channels; ++c) {
          if (subpixel) {
            const float* source = p.answer.buffer.floats() +
                                  (static_cast<std::ptrdiff_t>(y + 1) * p.coarse.row + x + 1) * p.answer.stride +
                                  16 * c;
            std::copy(source, source + 16, blocks[c].begin());
          } else {
            for (int i = 0; i < 16; ++i) {
              blocks[c][static_cast<std::size_t>(i)] =
                  p.answer.buffer.floats()[(static_cast<std::ptrdiff_t>(kScale * y + i / 4 + 1) * p.fine.row +
                                            kScale * x + i % 4 + 1) *
                                               p.answer.stride +
                                           c];
            }
          }
        }
        if (a.axes == "local") {
          for (int k = 0; k < 9; ++k) {
            upsample_block(p.axes.data() + k * image.height * w, image.height, w, y, x, axes[k]);
          }
        }
        for (int g = 0; g < channels; g += 3) {
          for (int c = 0; c < 3; ++c) {
            const auto channel = static_cast<std::size_t>(g + c);
            if (a.axes == "local") {
              const float scale = 1 / (normalization.maximum[channel] - normalization.minimum[channel]);
              for (std::size_t i = 0; i < 16; ++i) {
                const auto v = [&](int k) {
                  return blocks[g + k][i] * output_scale[static_cast<std::size_t>(g + k)] * axes[3 * k + c][i];
                };
                base[i] = (v(0) + v(1) + v(2)) * scale;
              }
            } else {
              const float scale = a.conditioned ? output_scale[channel] : 1.0F;
              for (std::size_t i = 0; i < 16; ++i) base[i] = blocks[channel][i] * scale;
            }
            if (a.residual == "bilinear") {
              Block interpolated;
              upsample_block(image.row(g + c, 0), image.height, w, y, x, interpolated);
              for (std::size_t i = 0; i < 16; ++i) base[i] += interpolated[i];
            } else if (a.residual == "mesh") {
              for (float& v : base) v += 0.5F;
              p.mesh->add(p.vertex_values.data(), channels, g + c, texel, base);
            }
            float* target =
                output + (g + c) * plane + static_cast<std::ptrdiff_t>(kScale * y) * fine_width + kScale * x;
            for (std::size_t i = 0; i < 4; ++i) {
              std::copy_n(base.data() + 4 * i, 4, target + static_cast<std::ptrdiff_t>(i) * fine_width);
            }
          }
        }
      }
    }
  }
};

bool Executor::supports(const Architecture& architecture, const Arrays& arrays) {
  const bool kind = architecture.kind == "mfsr" || architecture.kind == "srresnet";
  const bool mesh = architecture.residual != "mesh" || arrays.contains("base_vertex_texels");
  return kind && mesh && architecture.features <= kLargestOutputs && architecture.growth <= kLargestOutputs;
}

Executor::Executor(const Architecture& architecture, const Arrays& arrays, const ExecutorOptions& options)
    : state_(std::make_unique<State>(architecture, arrays, options)) {}

Executor::~Executor() = default;

const char* Executor::kernels() const { return state_->body->name; }

void Executor::run(const float* image, int height, int width, int channels, float* output) {
  State& s = *state_;
  if (s.plan.coarse.height != height || s.plan.coarse.width != width) s.make_plan(height, width);
  const Planes planes{image, height, width};
  const bool alone = s.team.largest() == 1 || s.pace.alone();
  const auto start = std::chrono::steady_clock::now();
  s.team.run([&](int member) { s.run_member(member, planes, channels, output); }, alone);
  const std::chrono::duration<double, std::milli> taken = std::chrono::steady_clock::now() - start;
  s.pace.took(alone, taken.count());
}

}  // namespace pleat::superres::cpu
