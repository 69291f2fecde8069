// One image through a network's layers, by the processor's own kernels.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "services/superres/kernels/layout.hpp"
#include "services/superres/kernels/weights.hpp"

namespace pleat::superres::kernels {

/// A parameter's values by its name (Layer::name).
using FindValues = std::function<std::span<const float>(const std::string& name)>;

/// What all images of one size share: layers, places, weights. A pixel shuffle at the end is no layer here: the answer
/// is rearranged on its way out.
struct Net {
  /// bfloat16: for all layers but the exact ones; throws kFailedPrecondition without has_bfloat16().
  Net(const Description& description, Size input, bool bfloat16, bool base_instructions);

  /// Throws kInvalidArgument naming the parameter whose size is wrong.
  void load(const FindValues& find);

  const Kernels& kernels_of(const Layer& layer) const { return layer.exact ? *plain : *body; }
  const Geometry& geometry(int value) const { return geometries[static_cast<std::size_t>(layout.value(value).size)]; }
  int layers() const { return static_cast<int>(network.layers.size()); }

  int shuffle = 1;  ///< factor of the pixel shuffle at the end
  Description network;
  const Kernels* plain;
  const Kernels* body;
  Layout layout;
  std::vector<Geometry> geometries;  ///< as Layout::sizes
  struct Weights {
    Buffer weights, bias, slope;
  };
  std::vector<Weights> weights;  ///< one a layer
};

/// The images of Layout.
class Memory {
 public:
  /// reuse: images of equal shape share memory where one is read no more when the other is written (inference).
  Memory(const Net& net, bool reuse);

  void* at(const Layout& layout, const Place& place, std::size_t pixel = 0) const {
    const ImageLayout& image = layout.image(place);
    return images_[static_cast<std::size_t>(place.image)]->at(
        pixel * static_cast<std::size_t>(image.channels) + static_cast<std::size_t>(place.first), image.element);
  }
  float* floats(const Layout& layout, const Place& place, std::size_t pixel = 0) const {
    return static_cast<float*>(at(layout, place, pixel));
  }

 private:
  std::vector<std::shared_ptr<Buffer>> images_;
};

/// Transformed tiles of the images that several layers read (ReadLayout::transform_from).
Buffer make_tiles(const Net& net);

/// Scratch of one thread.
struct Scratch {
  explicit Scratch(const Net& net);
  Buffer strip, sums, line;
};

/// Rows of tiles of a geometry that belong to one of several threads.
struct Rows {
  int begin = 0, end = 0;
  Rows(const Geometry& g, int member, int members)
      : begin(g.tiles_y * member / members), end(g.tiles_y * (member + 1) / members) {}
};

/// True if a layer reads what other threads have made: they have to meet before it.
bool reads_neighbours(const Layer& layer);

/// Planes (count, h, w) into channels [first, first + count) of the input, for a thread's rows.
void read_input(const Net& net, const Memory& memory, const float* planes, int first, int count, Rows rows);

void run_layer(const Net& net, int layer, const Memory& memory, const Buffer& tiles, const Scratch& scratch, Rows rows);

/// The first `channels` of the answer as planes (channels, H, W), for a thread's rows.
void write_answer(const Net& net, const Memory& memory, int channels, float* planes, Rows rows);

/// Calls use(pixel) for the pixels of some rows of tiles.
template <typename Use>
void for_pixels(const Geometry& g, Rows rows, const Use& use) {
  const int last = rows.end * kTile < g.height ? rows.end * kTile : g.height;
  for (int y = rows.begin * kTile; y < last; ++y) {
    for (int x = 0; x < g.width; ++x) use(g.pixel(y, x));
  }
}

}  // namespace pleat::superres::kernels
