#include "services/superres/kernels/backward.hpp"

#include <algorithm>
#include <cstring>

#include "services/superres/kernels/resample.hpp"

namespace pleat::superres::kernels {
namespace {

std::size_t at(int index) { return static_cast<std::size_t>(index); }

bool is_convolution(const Layer& layer) { return layer.kind == LayerKind::kConvolution; }

/// Groups of tiles or pixels.
int groups_of(const Kernels& kernels, std::size_t members) {
  const auto group = static_cast<std::size_t>(kernels.group);
  return static_cast<int>((members + group - 1) / group);
}

/// Elements of a plane of groups: an odd number of cache lines, so that planes don't fall on each other.
std::size_t plane_of(const Kernels& kernels, int groups, int channels) {
  const std::size_t line = 64 / static_cast<std::size_t>(kernels.element);
  std::size_t lines = (times(groups, channels) * static_cast<std::size_t>(kernels.group) + line - 1) / line;
  lines += 1 - lines % 2;
  return lines * line;
}

Rows all_rows(const Geometry& g) { return {g, 0, 1}; }

}  // namespace

BackwardNet::BackwardNet(const Net& forward) : net(forward) {
  place_gradients();
  plan_gathers();
  plan_groups();
  int widest = 0;
  for (const ValueLayout& value : net.layout.values) widest = std::max(widest, value.padded);
  no_bias = Buffer(times(widest, 4));
}

/// As the values themselves lie, so that layers whose outputs are read together have their gradients together.
void BackwardNet::place_gradients() {
  std::vector<int> image_of(net.layout.images.size(), -1);
  places.resize(net.layout.values.size());
  for (int i = 0; i < net.layers(); ++i) {
    const Layer& layer = net.network.layers[at(i)];
    if (!is_convolution(layer)) continue;
    const int element = net.kernels_of(layer).element;
    const ValueLayout& value = net.layout.value(i + 1);
    Place& target = places[at(i + 1)];
    for (const Place& place : value.places) {
      if (target.exists() || net.layout.image(place).element != element) continue;
      int& image = image_of[at(place.image)];
      if (image < 0) {
        image = static_cast<int>(images.size());
        images.push_back(net.layout.image(place));
      }
      target = {image, place.first};
    }
    if (target.exists()) continue;
    target = {static_cast<int>(images.size()), 0};
    images.push_back({value.size, value.padded, element, {i + 1}});
  }
}

void BackwardNet::plan_gathers() {
  gathers.resize(net.layout.values.size());
  for (int i = 0; i < net.layers(); ++i) {
    const Layer& layer = net.network.layers[at(i)];
    if (!is_convolution(layer)) continue;
    const Place& own = places[at(i + 1)];
    const int padded = net.layout.value(i + 1).padded;
    for (const int value : layer.inputs) {
      if (value == 0) continue;
      auto& list = gathers[at(value)];
      Gather* last = list.empty() ? nullptr : &list.back();
      const bool continues = last != nullptr && layer.kernel == 3 &&
                             net.network.layers[at(last->layers[0])].kernel == 3 &&
                             net.network.layers[at(last->layers[0])].exact == layer.exact &&
                             last->from.image == own.image && last->from.first + last->k == own.first;
      if (!continues) {
        list.emplace_back();
        last = &list.back();
        last->from = own;
      }
      last->layers.push_back(i);
      last->k += padded;
    }
  }
  for (std::size_t v = 1; v < gathers.size(); ++v) {
    for (Gather& gather : gathers[v]) {
      const Layer& layer = net.network.layers[at(gather.layers[0])];
      gather.weights =
          Buffer(Taps::packed_bytes(net.kernels_of(layer), layer.kernel, gather.k, net.layout.values[v].padded));
    }
  }
}

void BackwardNet::plan_groups() {
  group_of.assign(net.network.layers.size(), -1);
  std::map<std::pair<int, bool>, int> of_image;
  for (int i = 0; i < net.layers(); ++i) {
    const Layer& layer = net.network.layers[at(i)];
    if (!is_convolution(layer)) continue;
    const ReadLayout& read = net.layout.reads[at(i)];
    const bool shared = layer.kernel == 3 && read.from.first == 0;
    const auto [found, fresh] = of_image.try_emplace({read.from.image, layer.exact}, static_cast<int>(groups.size()));
    int group = found->second;
    if (!shared || fresh) {
      group = static_cast<int>(groups.size());
      groups.emplace_back();
      if (!shared && fresh) of_image.erase(found);
    }
    group_of[at(i)] = group;
    groups[at(group)].layers.push_back(i);
    groups[at(group)].k = std::max(groups[at(group)].k, read.k);
  }
}

void BackwardNet::load(const FindValues& find) {
  for (std::size_t v = 1; v < gathers.size(); ++v) {
    for (const Gather& gather : gathers[v]) {
      const Layer& first = net.network.layers[at(gather.layers[0])];
      const int n = net.layout.values[v].padded;
      Taps taps(first.kernel, gather.k, n);
      for (const int i : gather.layers) {
        const Layer& layer = net.network.layers[at(i)];
        int column = 0;
        for (const int value : layer.inputs) {
          if (value == static_cast<int>(v)) break;
          column += net.layout.value(value).padded;
        }
        taps.put_turned(find(layer.name + "_weight"), net.layout.reads[at(i)].channels,
                        places[at(i + 1)].first - gather.from.first, column);
      }
      taps.pack(net.kernels_of(first), gather.weights);
    }
  }
}

BackwardWorker::BackwardWorker(const BackwardNet& plan)
    : plan_(plan),
      net_(plan.net),
      float_of_(plan.net.layout.values.size(), -1),
      transformed_(plan.net.network.layers.size(), false),
      waiting_(plan.groups.size(), 0) {
  const auto geometry = [&](int size) -> const Geometry& { return net_.geometries[at(size)]; };
  std::size_t tile_bytes = 0, group_bytes = 0, largest = 0;
  int widest = 0;
  for (const ImageLayout& image : plan_.images) {
    images_.emplace_back(geometry(image.size).pixels() * times(image.channels, image.element));
    tile_bytes = std::max(tile_bytes, geometry(image.size).tiles() * kPoints * times(image.channels, image.element));
  }
  for (int i = 0; i < net_.layers(); ++i) {
    const Layer& layer = net_.network.layers[at(i)];
    const int n = net_.layout.value(i + 1).padded, k = net_.layout.reads[at(i)].k;
    widest = std::max(widest, n);
    gradients_.emplace_back();
    if (!is_convolution(layer)) continue;
    const std::size_t size = times(layer.kernel, layer.kernel) * times(k, n);
    gradients_.back() = {Buffer(size * sizeof(float)), Buffer(times(n, 4))};
    largest = std::max(largest, (layer.kernel == 3 ? kPoints : 1) * times(k, n));
    const Geometry& g = net_.geometry(i + 1);
    const Kernels& kernels = net_.kernels_of(layer);
    const bool three = layer.kernel == 3;
    const int groups = groups_of(kernels, three ? g.tiles() : times(g.height, g.width));
    const int channels = std::max(n, plan_.groups[at(plan_.group_of[at(i)])].k);
    group_bytes = std::max(group_bytes, (three ? kPoints : 1) * plane_of(kernels, groups, channels) *
                                            static_cast<std::size_t>(kernels.element));
  }
  tiles_ = Buffer(tile_bytes), input_groups_ = Buffer(group_bytes), output_groups_ = Buffer(group_bytes);
  sums_ = Buffer(largest * sizeof(float)), scratch_ = Buffer(kScratch * sizeof(float));
  line_ = Buffer(times(widest, 4));
}

void BackwardWorker::clear() {
  for (std::size_t i = 0; i < gradients_.size(); ++i) {
    const Layer& layer = net_.network.layers[i];
    if (!is_convolution(layer)) continue;
    const int n = net_.layout.values[i + 1].padded;
    std::fill_n(gradients_[i].taps.floats(), times(layer.kernel, layer.kernel) * times(net_.layout.reads[i].k, n),
                0.0F);
    std::fill_n(gradients_[i].bias.floats(), n, 0.0F);
  }
}

void* BackwardWorker::place(const Place& place, std::size_t pixel) const {
  const ImageLayout& image = plan_.images[at(place.image)];
  return images_[at(place.image)].at(pixel * at(image.channels) + at(place.first), image.element);
}

/// A float32 image for a value's gradient, which has none. Its values are undefined.
int BackwardWorker::take(int value) {
  const int stride = net_.layout.value(value).padded;
  auto& list = free_[{net_.geometry(value).pixels(), stride}];
  if (list.empty()) {
    list.push_back(static_cast<int>(floats_.size()));
    floats_.push_back({Buffer(net_.geometry(value).pixels() * times(stride, 4)), stride});
  }
  float_of_[at(value)] = list.back();
  list.pop_back();
  return float_of_[at(value)];
}

void BackwardWorker::give_back(int value) {
  int& index = float_of_[at(value)];
  if (index < 0) return;
  free_[{net_.geometry(value).pixels(), floats_[at(index)].stride}].push_back(index);
  index = -1;
}

/// Adds the gradient of value `from`, which is finished, to that of `value`, of equal size.
void BackwardWorker::add(int value, int from) {
  if (float_of_[at(value)] < 0) {
    std::swap(float_of_[at(value)], float_of_[at(from)]);
    return;
  }
  const Image &target = floats_[at(float_of_[at(value)])], &source = floats_[at(float_of_[at(from)])];
  const int channels = net_.layout.value(value).padded;
  const Geometry& g = net_.geometry(value);
  for_pixels(g, all_rows(g), [&](std::size_t p) {
    float* sum = target.at(p);
    const float* part = source.at(p);
    for (int c = 0; c < channels; ++c) sum[c] += part[c];
  });
}

void BackwardWorker::read_answer(const float* planes) {
  const int value = net_.layers(), f = net_.shuffle;
  const ValueLayout& layout = net_.layout.value(value);
  const Geometry& g = net_.geometry(value);
  const std::size_t width = times(g.width, f), plane = width * times(g.height, f);
  const Image& target = floats_[at(take(value))];
  for (int y = 0; y < g.height; ++y) {
    for (int x = 0; x < g.width; ++x) {
      float* values = target.at(g.pixel(y, x));
      for (int c = 0; c < layout.channels; ++c) {
        const int channel = c / (f * f), i = c / f % f, j = c % f;
        values[c] = planes[at(channel) * plane + at(y * f + i) * width + at(x * f + j)];
      }
      std::fill(values + layout.channels, values + layout.padded, 0.0F);
    }
  }
}

void BackwardWorker::run(const float* gradient, const Memory& memory) {
  std::fill(float_of_.begin(), float_of_.end(), -1);
  for (std::size_t g = 0; g < waiting_.size(); ++g) waiting_[g] = static_cast<int>(plan_.groups[g].layers.size());
  tiles_image_ = -1;
  read_answer(gradient);
  for (int value = net_.layers(); value > 0; --value) {
    value_gradient(value, memory);
    give_back(value);
  }
}

void BackwardWorker::value_gradient(int value, const Memory& memory) {
  const Layer& layer = net_.network.layers[at(value - 1)];
  const bool narrowed = gather(value, memory);
  if (!is_convolution(layer)) return resample_gradients(value);
  if (!narrowed) narrow(value, memory);
  weights(value - 1, memory);
  if (layer.add > 0) add(layer.add, value);
}

/// The gradient of a value from all layers that read it. True if it is in its place already.
bool BackwardWorker::gather(int value, const Memory& memory) {
  const auto& list = plan_.gathers[at(value)];
  const Layer& own = net_.network.layers[at(value - 1)];
  const Geometry& g = net_.geometry(value);
  const ValueLayout& layout = net_.layout.value(value);
  for (std::size_t i = 0; i < list.size(); ++i) {
    const BackwardNet::Gather& gather = list[i];
    const Layer& layer = net_.network.layers[at(gather.layers[0])];
    const Kernels& kernels = net_.kernels_of(layer);
    const bool some = float_of_[at(value)] >= 0;
    const Image& image = floats_[at(some ? float_of_[at(value)] : take(value))];
    ConvolutionCall call{};
    call.k = gather.k, call.n = layout.padded;
    call.weights = gather.weights.data(), call.bias = plan_.no_bias.floats();
    call.scratch = scratch_.floats();
    if (some) call.add = image.buffer.floats(), call.add_stride = image.stride;
    call.output = image.buffer.floats(), call.output_stride = image.stride;

    // The last one writes the finished gradient to its place, too, if that has its type.
    bool finishes = i + 1 == list.size() && is_convolution(own) && net_.kernels_of(own).element == kernels.element;
    if (finishes && own.activation == Activation::kRelu) {
      finishes = false;
      for (const Place& place : layout.places) {
        if (finishes || net_.layout.image(place).element != kernels.element) continue;
        call.mask = memory.at(net_.layout, place), call.mask_stride = net_.layout.image(place).channels;
        finishes = true;
      }
    }
    if (finishes) {
      const Place& target = plan_.places[at(value)];
      call.stored = place(target), call.stored_stride = plan_.images[at(target.image)].channels;
      if (own.add <= 0) call.output = nullptr;
    }
    if (layer.kernel == 1) {
      call.input = place(gather.from), call.input_stride = plan_.images[at(gather.from.image)].channels;
      kernels.convolve1(g, call, 0, g.tiles_y);
    } else {
      transform(gather, kernels, g);
      const int stride = plan_.images[at(gather.from.image)].channels;
      call.input = tiles_.at(at(gather.from.first), kernels.element), call.input_stride = stride;
      kernels.convolve3(g, call, 0, g.tiles_y);
    }
    if (finishes) return true;
  }
  if (float_of_[at(value)] < 0) {
    // Nobody reads it.
    const Image& image = floats_[at(take(value))];
    std::memset(image.buffer.data(), 0, g.pixels() * times(image.stride, 4));
  }
  return false;
}

/// Tiles of the gradients that a gather reads, unless they are there.
void BackwardWorker::transform(const BackwardNet::Gather& gather, const Kernels& kernels, const Geometry& g) {
  if (tiles_image_ != gather.from.image) {
    tiles_image_ = gather.from.image;
    std::fill(transformed_.begin(), transformed_.end(), false);
  }
  const int stride = plan_.images[at(gather.from.image)].channels;
  for (const int layer : gather.layers) {
    if (transformed_[at(layer)]) continue;
    transformed_[at(layer)] = true;
    const int first = plan_.places[at(layer + 1)].first, channels = net_.layout.value(layer + 1).padded;
    kernels.transform(g, {place({gather.from.image, 0}), stride, first, channels, tiles_.data(), stride, first, 0}, 0,
                      g.tiles_y);
  }
}

/// From the float32 gradient of a convolution's output to that before its activation, in its place.
void BackwardWorker::narrow(int value, const Memory& memory) {
  const Layer& layer = net_.network.layers[at(value - 1)];
  const ValueLayout& layout = net_.layout.value(value);
  const Kernels& kernels = net_.kernels_of(layer);
  const Geometry& g = net_.geometry(value);
  const Image& image = floats_[at(float_of_[at(value)])];
  const Place& target = plan_.places[at(value)];
  for_pixels(g, all_rows(g), [&](std::size_t p) {
    float* gradient = image.at(p);
    if (layer.activation == Activation::kRelu) {
      const Place& own = layout.places.front();
      if (net_.layout.image(own).element == 4) {
        const float* answer = memory.floats(net_.layout, own, p);
        for (int c = 0; c < layout.padded; ++c) gradient[c] = answer[c] > 0 ? gradient[c] : 0;
      } else {
        // Zero, of either sign, where it was not positive.
        const auto* answer = static_cast<const std::uint16_t*>(memory.at(net_.layout, own, p));
        for (int c = 0; c < layout.padded; ++c) gradient[c] = (answer[c] & 0x7FFFU) != 0 ? gradient[c] : 0;
      }
    }
    kernels.store(gradient, place(target, p), layout.padded);
  });
}

void BackwardWorker::resample_gradients(int value) {
  const Layer& layer = net_.network.layers[at(value - 1)];
  const int input = layer.inputs[0];
  if (input == 0) return;
  const Geometry &from = net_.geometry(input), &to = net_.geometry(value);
  if (float_of_[at(input)] < 0) {
    const Image& fresh = floats_[at(take(input))];
    std::memset(fresh.buffer.data(), 0, from.pixels() * times(fresh.stride, 4));
  }
  const Image &source = floats_[at(float_of_[at(input)])], &target = floats_[at(float_of_[at(value)])];
  const int channels = net_.layout.value(value).channels;
  for (int y = 0; y < to.height; ++y) {
    for (int x = 0; x < to.width; ++x) {
      resample_gradient(layer, from, to, source.buffer.floats(), source.stride, channels, y, x,
                        target.at(to.pixel(y, x)));
    }
  }
}

/// When the gradients of all layers of a group are there: those of their weights.
void BackwardWorker::weights(int layer, const Memory& memory) {
  const int group = plan_.group_of[at(layer)];
  if (--waiting_[at(group)] == 0) group_weights(plan_.groups[at(group)], memory);
}

void BackwardWorker::group_weights(const BackwardNet::WeightGroup& group, const Memory& memory) {
  const int first = group.layers[0];
  const bool three = net_.network.layers[at(first)].kernel == 3;
  const Kernels& kernels = net_.kernels_of(net_.network.layers[at(first)]);
  const Geometry& g = net_.geometry(first + 1);
  const int groups = groups_of(kernels, three ? g.tiles() : times(g.height, g.width));
  const Place& from = net_.layout.reads[at(first)].from;
  const auto group_in = three ? kernels.group_inputs : kernels.group_pixels;
  const auto group_out = three ? kernels.group_outputs : kernels.group_pixels;
  group_in(g, {memory.at(net_.layout, {from.image, 0}), net_.layout.image(from).channels, from.first, group.k,
               input_groups_.data(), plane_of(kernels, groups, group.k), group.k, 0});
  for (const int layer : group.layers) {
    const Place& own = plan_.places[at(layer + 1)];
    const int n = net_.layout.value(layer + 1).padded;
    group_out(g, {place({own.image, 0}), plan_.images[at(own.image)].channels, own.first, n, output_groups_.data(),
                  plane_of(kernels, groups, n), n, 0});
    correlate(layer, kernels, groups, group.k);
    bias(layer);
  }
}

void BackwardWorker::correlate(int layer, const Kernels& kernels, int groups, int stride) {
  const int kernel = net_.network.layers[at(layer)].kernel, points = kernel == 3 ? kPoints : 1;
  const int k = net_.layout.reads[at(layer)].k, n = net_.layout.value(layer + 1).padded;
  kernels.correlate({input_groups_.data(), output_groups_.data(), plane_of(kernels, groups, stride),
                     plane_of(kernels, groups, n), stride, n, points, groups, k, n, sums_.floats()});
  float* target = gradients_[at(layer)].taps.floats();
  if (kernel == 3) {
    kernels.add_taps(sums_.floats(), k, n, target);
  } else {
    for (std::size_t i = 0; i < times(k, n); ++i) target[i] += sums_.floats()[i];
  }
}

void BackwardWorker::bias(int layer) {
  const int channels = net_.layout.value(layer + 1).padded;
  const Place& own = plan_.places[at(layer + 1)];
  const Geometry& g = net_.geometry(layer + 1);
  float* sums = gradients_[at(layer)].bias.floats();
  const bool floats = plan_.images[at(own.image)].element == 4;
  for_pixels(g, all_rows(g), [&](std::size_t p) {
    if (floats) {
      const auto* values = static_cast<const float*>(place(own, p));
      for (int c = 0; c < channels; ++c) sums[c] += values[c];
      return;
    }
    const auto* halves = static_cast<const std::uint16_t*>(place(own, p));
    for (int c = 0; c < channels; ++c) {
      const std::uint32_t bits = static_cast<std::uint32_t>(halves[c]) << 16;
      float value;
      std::memcpy(&value, &bits, sizeof value);
      sums[c] += value;
    }
  });
}

}  // namespace pleat::superres::kernels
