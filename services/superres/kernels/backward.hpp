// The gradients of one image, value by value from the last to the first.
//
// The gradient of a value is gathered from all layers that read it. Those whose own gradients lie side by side are one
// convolution: in a dense block, where each layer reads all before it, that is one for each layer.
#pragma once

#include <map>
#include <utility>
#include <vector>

#include "services/superres/kernels/forward.hpp"

namespace pleat::superres::kernels {

/// Sums of one thread over its images.
struct Gradient {
  Buffer taps, bias;  ///< (kernel^2, k, n), (n): padded
};

/// How gradients flow, and the weights that they flow through: what all images share.
struct BackwardNet {
  explicit BackwardNet(const Net& net);

  void load(const FindValues& find);

  /// One convolution of a gradient.
  struct Gather {
    std::vector<int> layers;  ///< that read the value: one, or several of kernel 3 whose gradients lie side by side
    Place from;               ///< in `images`
    int k = 0;                ///< channels from there
    Buffer weights;
  };
  /// Layers of kernel 3 whose weights' gradients share the transform of one image.
  struct WeightGroup {
    std::vector<int> layers;
    int k = 0;  ///< channels of the image that are read
  };

  const Net& net;
  std::vector<ImageLayout> images;           ///< of gradients
  std::vector<Place> places;                 ///< of each value's gradient in them, before its layer's activation
  std::vector<std::vector<Gather>> gathers;  ///< of each value
  std::vector<WeightGroup> groups;
  std::vector<int> group_of;  ///< of each layer; -1: no convolution
  Buffer no_bias;

 private:
  void place_gradients();
  void plan_gathers();
  void plan_groups();
};

/// Scratch of one thread, and its sums.
class BackwardWorker {
 public:
  explicit BackwardWorker(const BackwardNet& plan);

  void clear();
  /// gradient: (outputs, H, W) of write_answer()'s planes; memory: of the forward pass, nothing reused. Adds to
  /// gradients().
  void run(const float* gradient, const Memory& memory);

  std::vector<Gradient>& gradients() { return gradients_; }  ///< one a layer

 private:
  struct Image {
    Buffer buffer;
    int stride = 0;
    float* at(std::size_t pixel) const { return buffer.floats() + pixel * static_cast<std::size_t>(stride); }
  };

  void* place(const Place& place, std::size_t pixel = 0) const;
  int take(int value);
  void give_back(int value);
  void add(int value, int from);
  void read_answer(const float* planes);
  void value_gradient(int value, const Memory& memory);
  bool gather(int value, const Memory& memory);
  void transform(const BackwardNet::Gather& gather, const Kernels& kernels, const Geometry& g);
  void narrow(int value, const Memory& memory);
  void resample_gradients(int value);
  void weights(int layer, const Memory& memory);
  void group_weights(const BackwardNet::WeightGroup& group, const Memory& memory);
  void correlate(int layer, const Kernels& kernels, int groups, int stride);
  void bias(int layer);

  const BackwardNet& plan_;
  const Net& net_;
  std::vector<Buffer> images_;                                    ///< BackwardNet::images
  std::vector<Image> floats_;                                     ///< float32 gradients, of no value or of one
  std::map<std::pair<std::size_t, int>, std::vector<int>> free_;  ///< by pixels and stride
  std::vector<int> float_of_;                                     ///< of each value, in floats_; -1: none yet
  Buffer tiles_, input_groups_, output_groups_, sums_, scratch_, line_;
  int tiles_image_ = -1;
  std::vector<bool> transformed_;  ///< of each layer
  std::vector<int> waiting_;       ///< layers of each group whose gradient is not there yet
  std::vector<Gradient> gradients_;
};

}  // namespace pleat::superres::kernels
