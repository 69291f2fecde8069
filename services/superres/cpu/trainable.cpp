#include "services/superres/cpu/trainable.hpp"

#include <algorithm>
#include <vector>

#include "services/superres/cpu/team.hpp"
#include "services/superres/cpu/trainable_layers.hpp"
#include "services/superres/cpu/trainable_passes.hpp"

namespace pleat::superres::cpu {

struct Trainable::State {
  State(const Architecture& architecture, const TrainableOptions& options)
      : net(architecture, options), team(options.threads) {
    for (int w = 0; w < options.threads; ++w) workers.emplace_back(net);
  }

  std::size_t texels() const { return times(net.g.height, net.g.width); }
  std::size_t output_size() const { return static_cast<std::size_t>(net.outputs()) * texels(); }

  /// The gradients of all workers, in those of the first.
  const std::vector<Gradient>& sum_gradients() {
    const auto add = [](const Buffer& part, const Buffer& sum, std::size_t size) {
      for (std::size_t i = 0; i < size; ++i) sum.floats()[i] += part.floats()[i];
    };
    for (std::size_t index = 0; index < net.convolutions.size(); ++index) {
      const Convolution& c = net.convolutions[index];
      const Gradient& sum = workers[0].gradients[index];
      for (std::size_t other = 1; other < workers.size(); ++other) {
        const Gradient& part = workers[other].gradients[index];
        add(part.taps, sum.taps, c.size());
        add(part.bias, sum.bias, static_cast<std::size_t>(c.padded_outputs));
      }
    }
    return workers[0].gradients;
  }

  TrainableLayers net;
  Team team;
  std::vector<Kept> kept;
  std::vector<Worker> workers;
  int kept_count = 0;
};

bool Trainable::supports(const Architecture& architecture) {
  return (architecture.kind == "mfsr" || architecture.kind == "srresnet") &&
         architecture.features + architecture.layers * architecture.growth <= kLargestOutputs / 2 &&
         architecture.blocks * architecture.features <= kLargestOutputs / 2;
}

Trainable::Trainable(const Architecture& architecture, const TrainableOptions& options)
    : state_(std::make_unique<State>(architecture, options)) {}

Trainable::~Trainable() = default;

const TrainableOptions& Trainable::options() const { return state_->net.options; }
int Trainable::outputs() const { return state_->net.outputs(); }

void Trainable::load(const std::function<Parameter(const std::string&)>& find) { state_->net.load(find); }

void Trainable::forward(const float* input, int count, float* output, bool keep) {
  State& s = *state_;
  const auto needed = static_cast<std::size_t>(keep ? std::max(count, s.team.largest()) : s.team.largest());
  while (s.kept.size() < needed) s.kept.emplace_back(s.net);
  s.kept_count = keep ? count : 0;
  const std::size_t input_size = static_cast<std::size_t>(s.net.options.inputs) * s.texels();
  s.team.run([&](int member) {
    const int members = s.team.members();
    for (int n = member; n < count; n += members) {
      const auto image = static_cast<std::size_t>(n);
      forward_image(s.net, input + image * input_size, s.kept[static_cast<std::size_t>(keep ? n : member)],
                    s.workers[static_cast<std::size_t>(member)], output + image * s.output_size());
    }
  });
}

void Trainable::backward(const float* gradient, const std::function<Parameter(const std::string&)>& find) {
  State& s = *state_;
  s.team.run([&](int member) {
    Worker& worker = s.workers[static_cast<std::size_t>(member)];
    for (std::size_t i = 0; i < s.net.convolutions.size(); ++i) {
      std::fill_n(worker.gradients[i].taps.floats(), s.net.convolutions[i].size(), 0.0F);
      std::fill_n(worker.gradients[i].bias.floats(), s.net.convolutions[i].padded_outputs, 0.0F);
    }
    for (int n = member; n < s.kept_count; n += s.team.members()) {
      const auto image = static_cast<std::size_t>(n);
      backward_image(s.net, gradient + image * s.output_size(), s.kept[image], worker);
    }
  });
  s.net.add_gradients(s.sum_gradients(), find);
}

}  // namespace pleat::superres::cpu
