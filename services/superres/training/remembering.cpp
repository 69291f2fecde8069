#include "services/superres/training/remembering.hpp"

#include <vector>

namespace pleat::superres {

bool Remembering::in_autoencoders(int epoch) const {
  return !description().twins.empty() && epoch < config_.autoencoders.epochs;
}

torch::Tensor Remembering::autoencoder_loss(const Batch& batch) const {
  std::vector<int> wanted;
  for (const auto& twin : description().twins) wanted.insert(wanted.end(), {twin.out, twin.in, twin.code});
  const auto values = network_.values({batch.input, {}, batch.answer}, wanted, body_);
  auto loss = torch::zeros({}, batch.input.options());
  for (std::size_t i = 0; i < values.size(); i += 3) {
    const auto largest = std::get<0>(values[i + 2].abs().max(0));
    loss = loss + (values[i] - values[i + 1]).square().sum() / values[i].size(0) +
           torch::relu(largest - config_.autoencoders.largest).mean();
  }
  return loss;
}

void Remembering::hold_autoencoders(int epoch, const Adam& adam) const {
  if (description().twins.empty() || config_.autoencoders.epochs == 0 || in_autoencoders(epoch)) return;
  std::vector<int> wanted;
  for (const auto& twin : description().twins) wanted.push_back(twin.out);
  const torch::NoGradGuard no_grad;
  for (const std::size_t i : network_.parameters_of(wanted)) {
    auto value = network_.parameters()[i].second;
    value.copy_(adam.average[i]);
    value.set_requires_grad(false);
  }
}

torch::Tensor Remembering::after_lead(const Batch& batch, torch::Tensor memory) const {
  if (!batch.lead.defined()) return memory;
  const torch::NoGradGuard no_grad;
  for (std::int64_t l = 0; l < batch.lead.size(1); ++l) {
    const auto left = network_.values({batch.lead.select(1, l), memory, {}}, {description().memory}, body_).front();
    const auto known = batch.lead_known.select(1, l).view({-1, 1, 1, 1}) > 0;
    memory = torch::where(known, network_.remember(memory, left), memory);
  }
  return memory;
}

torch::Tensor Remembering::answers(const Batch& batch, int epoch, int step, int first_window,
                                   torch::Tensor& codes) const {
  const std::int64_t windows = batch.known.size(0), remembered = batch.known.size(1), frames = batch.frames;
  const auto of_windows = [&](const torch::Tensor& t, std::int64_t each) {
    auto shape = t.sizes().vec();
    shape.erase(shape.begin());
    shape.insert(shape.begin(), {windows, each});
    return t.reshape(shape);
  };
  const auto left_by = [&](const torch::Tensor& answers) {
    return network_.values({batch.input, {}, answers}, {description().given_memory}, body_).front();
  };
  const auto true_codes = left_by(batch.answer);  // (B F, m, h', w')
  const auto before =
      of_windows(left_by(batch.before.flatten(0, 1)), remembered) * batch.known.view({windows, remembered, 1, 1, 1});
  // (B, R + F, m, h', w')
  auto line = torch::cat({before, of_windows(true_codes, frames)}, 1).detach();
  const std::vector<int> wanted{description().values() - 1, description().memory};
  torch::Tensor answers, own_codes;
  if (sampler_.is_free(epoch, step)) {
    const auto inputs = of_windows(batch.input, frames);
    auto memory = after_lead(batch, line.slice(1, 0, remembered).flatten(1, 2));
    std::vector<torch::Tensor> all, left;
    for (std::int64_t f = 0; f < frames; ++f) {
      const auto one = network_.values({inputs.select(1, f), memory, {}}, wanted, body_);
      all.push_back(one[0].to(torch::kFloat32));
      left.push_back(one[1]);
      memory = network_.remember(memory, one[1]);
    }
    answers = torch::stack(all, 1).flatten(0, 1);
    own_codes = torch::stack(left, 1).flatten(0, 1);
  } else {
    if (config_.history.noise > 0) {
      const auto deviation = config_.history.noise * true_codes.detach().std();
      line = line + deviation * sampler_.noise(epoch, step, first_window, line);
      // What was not there stays nothing.
      line.slice(1, 0, remembered).mul_(batch.known.view({windows, remembered, 1, 1, 1}));
    }
    std::vector<torch::Tensor> memories;
    for (std::int64_t f = 0; f < frames; ++f) memories.push_back(line.slice(1, f, f + remembered).flatten(1, 2));
    const auto memory = torch::stack(memories, 1).flatten(0, 1);
    const auto one = network_.values({batch.input, memory, {}}, wanted, body_);
    answers = one[0].to(torch::kFloat32);
    own_codes = one[1];
  }
  codes = (own_codes - true_codes.detach()).square().mean();
  return answers;
}

void run_on_own_answers(const Network& network, std::size_t frames, torch::ScalarType body,
                        const std::function<torch::Tensor(std::size_t)>& input,
                        const std::function<void(const torch::Tensor&, std::size_t)>& use) {
  const std::vector<int> wanted{network.description().values() - 1, network.description().memory};
  torch::Tensor memory;
  for (std::size_t f = 0; f < frames; ++f) {
    const auto x = input(f);
    if (!memory.defined()) memory = network.no_memory(x);
    const auto one = network.values({x, memory, {}}, wanted, body);
    memory = network.remember(memory, one[1]);
    use(one[0], f);
  }
}

}  // namespace pleat::superres
