#include "services/superres/kernels/layout.hpp"

#include <algorithm>
#include <numeric>

#include "services/superres/kernels/weights.hpp"

namespace pleat::superres::kernels {
namespace {

class Planner {
 public:
  Planner(const Description& network, Layout& layout, int lanes) : network_(network), layout_(layout), lanes_(lanes) {}

  void run(Size input) {
    make_values(input);
    layout_.reads.resize(network_.layers.size());
    for (std::size_t i = 0; i < network_.layers.size(); ++i) {
      if (network_.layers[i].kind == LayerKind::kConvolution) place_inputs(network_.layers[i], layout_.reads[i]);
    }
    place_floats();
    find_lives();
    share_tiles();
  }

 private:
  void make_values(Size input) {
    for (const Size size : network_.sizes(input)) {
      auto found = std::find(layout_.sizes.begin(), layout_.sizes.end(), size);
      if (found == layout_.sizes.end()) found = layout_.sizes.insert(found, size);
      ValueLayout value;
      value.channels = network_.channels(static_cast<int>(layout_.values.size()));
      value.padded = round_up(value.channels, lanes_);
      value.size = static_cast<int>(found - layout_.sizes.begin());
      layout_.values.push_back(std::move(value));
    }
  }

  ValueLayout& value(int index) { return layout_.values[static_cast<std::size_t>(index)]; }

  int new_image(int size, int element) {
    layout_.images.push_back({});
    layout_.images.back().size = size, layout_.images.back().element = element;
    return static_cast<int>(layout_.images.size()) - 1;
  }

  void append(int image, int index) {
    ImageLayout& target = layout_.images[static_cast<std::size_t>(image)];
    value(index).places.push_back({image, target.channels});
    target.channels += value(index).padded;
    target.values.push_back(index);
  }

  /// The image and the position in it of a list of values, or one that the list continues, or a new one.
  void place_inputs(const Layer& layer, ReadLayout& read) {
    const std::vector<int>& list = layer.inputs;
    const int element = layer.exact ? 4 : layout_.element;
    int image = -1;
    std::size_t first = 0;
    for (std::size_t i = 0; i < layout_.images.size() && image < 0; ++i) {
      const auto& values = layout_.images[i].values;
      if (layout_.images[i].element != element) continue;
      const auto found = std::search(values.begin(), values.end(), list.begin(), list.end());
      const bool continues = values.size() < list.size() && std::equal(values.begin(), values.end(), list.begin());
      if (found == values.end() && !continues) continue;
      image = static_cast<int>(i);
      first = found == values.end() ? 0 : static_cast<std::size_t>(found - values.begin());
    }
    if (image < 0) image = new_image(value(list[0]).size, element);
    for (std::size_t i = layout_.images[static_cast<std::size_t>(image)].values.size() - first; i < list.size(); ++i) {
      append(image, list[i]);
    }
    const auto& values = layout_.images[static_cast<std::size_t>(image)].values;
    for (std::size_t i = 0; i < first; ++i) read.from.first += value(values[i]).padded;
    read.from.image = image;
    for (const int index : list) {
      for (int c = 0; c < value(index).channels; ++c) read.channels.push_back(read.k + c);
      read.k += value(index).padded;
    }
  }

  void place_floats() {
    std::vector<bool> needed(layout_.values.size(), false);
    const auto need = [&](int index) { needed[static_cast<std::size_t>(index)] = true; };
    need(network_.values() - 1);
    for (std::size_t i = 0; i < network_.layers.size(); ++i) {
      const Layer& layer = network_.layers[i];
      if (layer.add >= 0) need(layer.add);
      if (layer.kind != LayerKind::kConvolution) need(layer.inputs[0]);
      // What the exact layers write, and what is read from the caller, is float32 before it is anything else.
      if (layer.exact) need(static_cast<int>(i) + 1);
    }
    need(0);
    for (std::size_t v = 0; v < needed.size(); ++v) {
      ValueLayout& value = layout_.values[v];
      for (const Place& place : value.places) {
        if (layout_.image(place).element == 4 && !value.floats.exists()) value.floats = place;
      }
      if (!needed[v] || value.floats.exists()) continue;
      const int image = new_image(value.size, 4);
      append(image, static_cast<int>(v));
      value.floats = value.places.back();
    }
  }

  void find_lives() {
    std::vector<int> last(layout_.values.size(), 0);
    const int end = static_cast<int>(network_.layers.size());
    for (int i = 0; i < end; ++i) {
      const Layer& layer = network_.layers[static_cast<std::size_t>(i)];
      for (const int index : layer.inputs) last[static_cast<std::size_t>(index)] = i;
      if (layer.add >= 0) last[static_cast<std::size_t>(layer.add)] = i;
    }
    last.back() = end;
    for (ImageLayout& image : layout_.images) {
      image.written = *std::min_element(image.values.begin(), image.values.end()) - 1;
      for (const int index : image.values) {
        image.last_read = std::max(image.last_read, last[static_cast<std::size_t>(index)]);
      }
    }
  }

  /// Tiles are kept where several layers read one image; there is room for one image's at a time.
  void share_tiles() {
    const auto is3 = [&](std::size_t i) {
      return network_.layers[i].kind == LayerKind::kConvolution && network_.layers[i].kernel == 3;
    };
    std::vector<int> readers(layout_.images.size(), 0);
    for (std::size_t i = 0; i < layout_.reads.size(); ++i) {
      if (is3(i)) ++readers[static_cast<std::size_t>(layout_.reads[i].from.image)];
    }
    int held = -1, done = 0;
    for (std::size_t i = 0; i < layout_.reads.size(); ++i) {
      ReadLayout& read = layout_.reads[i];
      if (!is3(i) || readers[static_cast<std::size_t>(read.from.image)] < 2 || read.from.first != 0) continue;
      if (held != read.from.image) held = read.from.image, done = 0;
      read.transform_from = std::min(done, read.k);
      done = std::max(done, read.k);
    }
  }

  const Description& network_;
  Layout& layout_;
  const int lanes_;
};

}  // namespace

Layout::Layout(const Description& network, Size input, int lanes, int element_bytes) : element(element_bytes) {
  Planner(network, *this, lanes).run(input);
}

}  // namespace pleat::superres::kernels
