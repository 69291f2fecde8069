#include "services/superres/kernels/trainable.hpp"

#include <algorithm>
#include <map>
#include <vector>

#include "services/superres/kernels/backward.hpp"
#include "services/superres/kernels/team.hpp"

namespace pleat::superres::kernels {
namespace {

/// One thread.
struct Worker {
  explicit Worker(const BackwardNet& plan) : tiles(make_tiles(plan.net)), scratch(plan.net), backward(plan) {}
  Buffer tiles;
  Scratch scratch;
  BackwardWorker backward;
};

}  // namespace

struct Trainable::State {
  State(const Description& network, const TrainableOptions& o)
      : options(o), net(network, o.input, o.bfloat16, o.base_instructions), backward(net), team(o.threads) {
    for (const Layer& layer : net.network.layers) {
      if (layer.kind != LayerKind::kConvolution) continue;
      const auto outputs = static_cast<std::size_t>(layer.channels);
      sizes[layer.name + "_bias"] = outputs;
      sizes[layer.name + "_weight"] =
          outputs * static_cast<std::size_t>(net.network.input_channels(layer)) * times(layer.kernel, layer.kernel);
    }
    for (int w = 0; w < o.threads; ++w) workers.push_back(std::make_unique<Worker>(backward));
  }

  std::size_t input_size() const {
    return times(net.network.inputs, options.input.height) * times(options.input.width, 1);
  }
  std::size_t output_size() const {
    const Geometry& g = net.geometry(net.layers());
    return static_cast<std::size_t>(net.network.outputs()) * times(g.height, g.width);
  }

  void forward_image(const float* input, const Memory& memory, const Worker& worker, float* output) const {
    read_input(net, memory, input, 0, net.network.inputs, {net.geometry(0), 0, 1});
    for (int i = 0; i < net.layers(); ++i) {
      run_layer(net, i, memory, worker.tiles, worker.scratch, {net.geometry(i + 1), 0, 1});
    }
    const int channels = net.network.outputs() / (net.shuffle * net.shuffle);
    write_answer(net, memory, channels, output, {net.geometry(net.layers()), 0, 1});
  }

  /// The gradients of all workers, in those of the first.
  const std::vector<Gradient>& sum_gradients() {
    const auto add = [](const Buffer& part, const Buffer& sum, std::size_t size) {
      for (std::size_t i = 0; i < size; ++i) sum.floats()[i] += part.floats()[i];
    };
    for (std::size_t i = 0; i < net.network.layers.size(); ++i) {
      const Layer& layer = net.network.layers[i];
      if (layer.kind != LayerKind::kConvolution) continue;
      const int n = net.layout.values[i + 1].padded;
      const Gradient& sum = workers[0]->backward.gradients()[i];
      for (std::size_t other = 1; other < workers.size(); ++other) {
        const Gradient& part = workers[other]->backward.gradients()[i];
        add(part.taps, sum.taps, times(layer.kernel, layer.kernel) * times(net.layout.reads[i].k, n));
        add(part.bias, sum.bias, static_cast<std::size_t>(n));
      }
    }
    return workers[0]->backward.gradients();
  }

  TrainableOptions options;
  Net net;
  BackwardNet backward;
  Team team;
  std::map<std::string, std::size_t> sizes;  ///< of the parameters
  std::vector<Memory> kept;
  std::vector<std::unique_ptr<Worker>> workers;
  int kept_count = 0;
};

bool Trainable::supports(const Description& network) {
  for (const Layer& layer : network.layers) {
    if (!is_image_layer(layer)) return false;
    const int widest = std::max(network.input_channels(layer), layer.channels);
    if (layer.activation == Activation::kPrelu || widest > kLargestOutputs / 2) return false;
  }
  return true;
}

Trainable::Trainable(const Description& network, const TrainableOptions& options)
    : state_(std::make_unique<State>(network, options)) {}

Trainable::~Trainable() = default;

const TrainableOptions& Trainable::options() const { return state_->options; }

Size Trainable::output_size() const {
  const Net& net = state_->net;
  const Geometry& g = net.geometry(net.layers());
  return {g.height * net.shuffle, g.width * net.shuffle};
}

void Trainable::load(const std::function<const float*(const std::string&)>& find) {
  State& s = *state_;
  const FindValues values = [&](const std::string& name) {
    return std::span<const float>(find(name), s.sizes.at(name));
  };
  s.net.load(values);
  s.backward.load(values);
}

void Trainable::forward(const float* input, int count, float* output, bool keep) {
  State& s = *state_;
  const auto needed = static_cast<std::size_t>(keep ? std::max(count, s.team.largest()) : s.team.largest());
  while (s.kept.size() < needed) s.kept.emplace_back(s.net, false);
  s.kept_count = keep ? count : 0;
  s.team.run([&](int member) {
    for (int n = member; n < count; n += s.team.members()) {
      const auto image = static_cast<std::size_t>(n);
      s.forward_image(input + image * s.input_size(), s.kept[static_cast<std::size_t>(keep ? n : member)],
                      *s.workers[static_cast<std::size_t>(member)], output + image * s.output_size());
    }
  });
}

void Trainable::backward(const float* gradient, const std::function<float*(const std::string&)>& find) {
  State& s = *state_;
  s.team.run([&](int member) {
    BackwardWorker& worker = s.workers[static_cast<std::size_t>(member)]->backward;
    worker.clear();
    for (int n = member; n < s.kept_count; n += s.team.members()) {
      const auto image = static_cast<std::size_t>(n);
      worker.run(gradient + image * s.output_size(), s.kept[image]);
    }
  });
  const auto& sums = s.sum_gradients();
  for (std::size_t i = 0; i < s.net.network.layers.size(); ++i) {
    const Layer& layer = s.net.network.layers[i];
    if (layer.kind != LayerKind::kConvolution) continue;
    const ReadLayout& read = s.net.layout.reads[i];
    const auto n = static_cast<std::size_t>(s.net.layout.values[i + 1].padded);
    const std::size_t taps = times(layer.kernel, layer.kernel);
    float* weight = find(layer.name + "_weight");
    float* bias = find(layer.name + "_bias");
    for (std::size_t o = 0; o < static_cast<std::size_t>(layer.channels); ++o) {
      bias[o] += sums[i].bias.floats()[o];
      for (const int channel : read.channels) {
        for (std::size_t t = 0; t < taps; ++t) {
          *weight++ +=
              sums[i].taps.floats()[(t * static_cast<std::size_t>(read.k) + static_cast<std::size_t>(channel)) * n + o];
        }
      }
    }
  }
}

}  // namespace pleat::superres::kernels
