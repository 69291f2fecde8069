#include "services/superres/kernels/forward.hpp"

#include <algorithm>
#include <cstring>

#include "common/base/error.hpp"
#include "services/superres/kernels/resample.hpp"

namespace pleat::superres::kernels {
namespace {

/// Transformed tiles of an image that one layer reads: few enough to stay in the processor's cache.
constexpr std::size_t kStripBytes = 256 << 10;

std::size_t strip_row(const Geometry& g, int channels, int element) {
  return times(g.tiles_x, kPoints) * times(channels, element);
}

/// A float32 pixel as elements of a place.
void store(const Net& net, const Place& place, const float* values, int channels, void* target) {
  if (net.layout.image(place).element == 4) {
    std::copy_n(values, channels, static_cast<float*>(target));
  } else {
    net.body->store(values, target, channels);
  }
}

/// Where a convolution writes by itself; copies: the places that are left.
ConvolutionCall with_targets(const Net& net, const Memory& memory, int value, const Kernels& kernels,
                             ConvolutionCall call, std::vector<Place>& copies) {
  const ValueLayout& v = net.layout.value(value);
  for (const Place& place : v.places) {
    const ImageLayout& image = net.layout.image(place);
    if (image.element == 4 && call.output == nullptr && place.image == v.floats.image) {
      call.output = memory.floats(net.layout, place), call.output_stride = image.channels;
    } else if (image.element == kernels.element && call.stored == nullptr) {
      call.stored = memory.at(net.layout, place), call.stored_stride = image.channels;
    } else if (image.element == kernels.element && call.also_stored == nullptr) {
      call.also_stored = memory.at(net.layout, place), call.also_stored_stride = image.channels;
    } else {
      copies.push_back(place);
    }
  }
  return call;
}

void convolve(const Net& net, int index, const Memory& memory, const Buffer& tiles, const Scratch& scratch, Rows rows) {
  const auto i = static_cast<std::size_t>(index);
  const Layer& layer = net.network.layers[i];
  const ReadLayout& read = net.layout.reads[i];
  const Geometry& g = net.geometry(index + 1);
  const Kernels& kernels = net.kernels_of(layer);
  const ValueLayout& value = net.layout.value(index + 1);
  const int stride = net.layout.image(read.from).channels;

  ConvolutionCall call{};
  call.k = read.k, call.n = value.padded;
  call.weights = net.weights[i].weights.data();
  call.bias = net.weights[i].bias.floats();
  call.scratch = scratch.sums.floats();
  if (layer.activation != Activation::kNone) call.slope = net.weights[i].slope.floats();
  if (layer.add >= 0) {
    const Place& add = net.layout.value(layer.add).floats;
    call.add = memory.floats(net.layout, add), call.add_stride = net.layout.image(add).channels;
  }
  std::vector<Place> copies;
  call = with_targets(net, memory, index + 1, kernels, call, copies);

  if (layer.kernel == 1) {
    call.input = memory.at(net.layout, read.from), call.input_stride = stride;
    kernels.convolve1(g, call, rows.begin, rows.end);
  } else if (read.transform_from >= 0) {
    const int first = read.transform_from;
    const Place image{read.from.image, 0};
    kernels.transform(g, {memory.at(net.layout, image), stride, first, read.k - first, tiles.data(), stride, first, 0},
                      rows.begin, rows.end);
    call.input = tiles.data(), call.input_stride = stride;
    kernels.convolve3(g, call, rows.begin, rows.end);
  } else {
    const std::size_t row = strip_row(g, read.k, kernels.element);
    const int several = std::max(1, static_cast<int>(kStripBytes / row));
    const Place image{read.from.image, 0};
    call.input = scratch.strip.data(), call.input_stride = read.k;
    for (int first = rows.begin; first < rows.end; first += several) {
      const int last = std::min(first + several, rows.end);
      call.origin = first;
      kernels.transform(
          g, {memory.at(net.layout, image), stride, read.from.first, read.k, scratch.strip.data(), read.k, 0, first},
          first, last);
      kernels.convolve3(g, call, first, last);
    }
  }
  for (const Place& place : copies) {
    for_pixels(g, rows, [&](std::size_t p) {
      store(net, place, memory.floats(net.layout, value.floats, p), value.padded, memory.at(net.layout, place, p));
    });
  }
}

void resample(const Net& net, int index, const Memory& memory, const Scratch& scratch, Rows rows) {
  const Layer& layer = net.network.layers[static_cast<std::size_t>(index)];
  const Geometry &from = net.geometry(layer.inputs[0]), &to = net.geometry(index + 1);
  const Place& source = net.layout.value(layer.inputs[0]).floats;
  const ValueLayout& value = net.layout.value(index + 1);
  float* line = scratch.line.floats();
  const int last = std::min(rows.end * kTile, to.height);
  for (int y = rows.begin * kTile; y < last; ++y) {
    for (int x = 0; x < to.width; ++x) {
      resample_pixel(layer, from, to, memory.floats(net.layout, source), net.layout.image(source).channels,
                     value.channels, y, x, line);
      std::fill(line + value.channels, line + value.padded, 0.0F);
      for (const Place& place : value.places) {
        store(net, place, line, value.padded, memory.at(net.layout, place, to.pixel(y, x)));
      }
    }
  }
}

/// The layers without a pixel shuffle at the end, and its factor.
Description without_shuffle(Description network, int& factor) {
  if (!network.layers.empty() && network.layers.back().kind == LayerKind::kPixelShuffle) {
    factor = network.layers.back().factor;
    network.layers.pop_back();
  }
  return network;
}

}  // namespace

Net::Net(const Description& description, Size input, bool bfloat16, bool base_instructions)
    : network(without_shuffle(description, shuffle)),
      plain(&float32_kernels(base_instructions)),
      body(bfloat16 ? &bfloat16_kernels(base_instructions) : plain),
      layout(network, input, std::max(plain->lanes, body->lanes), body->element) {
  for (const Size& size : layout.sizes) geometries.emplace_back(size.height, size.width);
  for (std::size_t i = 0; i < network.layers.size(); ++i) {
    const Layer& layer = network.layers[i];
    weights.emplace_back();
    if (layer.kind != LayerKind::kConvolution) continue;
    const int n = layout.values[i + 1].padded;
    const std::size_t row = static_cast<std::size_t>(n) * sizeof(float);
    weights.back().weights = Buffer(Taps::packed_bytes(kernels_of(layer), layer.kernel, layout.reads[i].k, n));
    weights.back().bias = Buffer(row), weights.back().slope = Buffer(row);
  }
}

void Net::load(const FindValues& find) {
  const auto values = [&](const std::string& name, std::size_t size) {
    const auto found = find(name);
    if (found.size() != size) {
      throw_invalid_argument("network: " + name + " has " + std::to_string(found.size()) + " values, expected " +
                             std::to_string(size));
    }
    return found;
  };
  for (std::size_t i = 0; i < network.layers.size(); ++i) {
    const Layer& layer = network.layers[i];
    if (layer.kind != LayerKind::kConvolution) continue;
    const ReadLayout& read = layout.reads[i];
    const auto outputs = static_cast<std::size_t>(layer.channels);
    Taps taps(layer.kernel, read.k, layout.values[i + 1].padded);
    taps.put(values(layer.name + "_weight", outputs * read.channels.size() * times(layer.kernel, layer.kernel)),
             read.channels);
    taps.pack(kernels_of(layer), weights[i].weights);
    const auto copy = [&](const char* part, const Buffer& target) {
      const auto found = values(layer.name + part, outputs);
      std::copy(found.begin(), found.end(), target.floats());
    };
    copy("_bias", weights[i].bias);
    if (layer.activation == Activation::kPrelu) copy("_slope", weights[i].slope);
  }
}

Memory::Memory(const Net& net, bool reuse) {
  const auto& layouts = net.layout.images;
  std::vector<std::size_t> order(layouts.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return layouts[a].written < layouts[b].written; });
  images_.resize(layouts.size());
  std::vector<int> last_read(layouts.size());  // of the memory that an image has, by all who have had it
  for (std::size_t at = 0; at < order.size(); ++at) {
    const ImageLayout& image = layouts[order[at]];
    last_read[order[at]] = image.last_read;
    for (std::size_t before = 0; reuse && before < at && !images_[order[at]]; ++before) {
      const std::size_t other = order[before];
      const ImageLayout& old = layouts[other];
      // The input stays: its constant channels are written once. The threads have to meet in between.
      if (old.written < 0 || old.size != image.size || old.channels != image.channels || old.element != image.element) {
        continue;
      }
      bool met = false;
      for (int layer = last_read[other] + 1; layer <= image.written && !met; ++layer) {
        met = reads_neighbours(net.network.layers[static_cast<std::size_t>(layer)]);
      }
      if (!met) continue;
      images_[order[at]] = images_[other];
      last_read[other] = image.last_read;
    }
    if (images_[order[at]]) {
      for (std::size_t other = 0; other < images_.size(); ++other) {
        if (images_[other] == images_[order[at]]) last_read[other] = image.last_read;
      }
      continue;
    }
    const Geometry& g = net.geometries[static_cast<std::size_t>(image.size)];
    images_[order[at]] = std::make_shared<Buffer>(g.pixels() * times(image.channels, image.element));
  }
}

Buffer make_tiles(const Net& net) {
  std::size_t bytes = 0;
  for (std::size_t i = 0; i < net.layout.reads.size(); ++i) {
    const ReadLayout& read = net.layout.reads[i];
    if (read.transform_from < 0) continue;
    const ImageLayout& image = net.layout.image(read.from);
    const Geometry& g = net.geometries[static_cast<std::size_t>(image.size)];
    bytes = std::max(bytes, g.tiles() * kPoints * times(image.channels, image.element));
  }
  return Buffer(bytes);
}

Scratch::Scratch(const Net& net) : sums(kScratch * sizeof(float)) {
  std::size_t row = kStripBytes;
  int widest = 0;
  for (std::size_t i = 0; i < net.network.layers.size(); ++i) {
    widest = std::max(widest, net.layout.values[i + 1].padded);
    if (net.network.layers[i].kind != LayerKind::kConvolution) continue;
    row = std::max(row, strip_row(net.geometry(static_cast<int>(i) + 1), net.layout.reads[i].k, 4));
  }
  strip = Buffer(row);
  line = Buffer(times(widest, 4));
}

bool reads_neighbours(const Layer& layer) { return layer.kind != LayerKind::kConvolution || layer.kernel != 1; }

void read_input(const Net& net, const Memory& memory, const float* planes, int first, int count, Rows rows) {
  const ValueLayout& value = net.layout.value(0);
  const Geometry& g = net.geometry(0);
  const std::size_t plane = times(g.height, g.width);
  for_pixels(g, rows, [&](std::size_t p) {
    const std::size_t row = p / static_cast<std::size_t>(g.row) - 1, column = p % static_cast<std::size_t>(g.row) - 1;
    const float* source = planes + row * static_cast<std::size_t>(g.width) + column;
    float* target = memory.floats(net.layout, value.floats, p);
    for (int c = 0; c < count; ++c) target[first + c] = source[static_cast<std::size_t>(c) * plane];
    for (const Place& place : value.places) {
      if (place.image == value.floats.image) continue;
      store(net, place, target, value.padded, memory.at(net.layout, place, p));
    }
  });
}

void run_layer(const Net& net, int layer, const Memory& memory, const Buffer& tiles, const Scratch& scratch,
               Rows rows) {
  if (net.network.layers[static_cast<std::size_t>(layer)].kind == LayerKind::kConvolution) {
    convolve(net, layer, memory, tiles, scratch, rows);
  } else {
    resample(net, layer, memory, scratch, rows);
  }
}

void write_answer(const Net& net, const Memory& memory, int channels, float* planes, Rows rows) {
  const int value = net.layers(), f = net.shuffle;
  const Geometry& g = net.geometry(value);
  const Place& place = net.layout.value(value).floats;
  const std::size_t width = times(g.width, f), plane = width * times(g.height, f);
  const int last = std::min(rows.end * kTile, g.height);
  for (int c = 0; c < channels; ++c) {
    for (int y = rows.begin * kTile; y < last; ++y) {
      for (int i = 0; i < f; ++i) {
        float* target = planes + static_cast<std::size_t>(c) * plane + static_cast<std::size_t>(y * f + i) * width;
        for (int x = 0; x < g.width; ++x, target += f) {
          std::copy_n(memory.floats(net.layout, place, g.pixel(y, x)) + (c * f + i) * f, f, target);
        }
      }
    }
  }
}

}  // namespace pleat::superres::kernels
