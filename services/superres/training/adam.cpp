#include "services/superres/training/adam.hpp"

#include <algorithm>
#include <cmath>

namespace pleat::superres {

Adam::Adam(std::vector<torch::Tensor> values, const OptimizerConfig& options)
    : config(options), parameters(std::move(values)) {
  for (const auto& p : parameters) {
    first.push_back(torch::zeros_like(p, torch::TensorOptions().requires_grad(false)));
    second.push_back(torch::zeros_like(p, torch::TensorOptions().requires_grad(false)));
    average.push_back(p.detach().clone());
  }
}

double Adam::step(double learning_rate) {
  const torch::NoGradGuard no_grad;
  std::vector<torch::Tensor> norms;
  for (const auto& p : parameters) {
    if (p.grad().defined()) norms.push_back(p.grad().norm());
  }
  if (norms.empty()) return 0;
  const double norm = torch::stack(norms).norm().item<double>();
  const double factor = config.clip > 0 && norm > config.clip ? config.clip / norm : 1.0;
  ++steps;
  const auto t = static_cast<double>(steps);
  const double correction1 = 1 - std::pow(config.beta1, t), correction2 = 1 - std::pow(config.beta2, t);
  // Early on the mean of few steps would keep the random beginning.
  const double decay = config.average > 0 ? std::min(config.average, (1 + t) / (10 + t)) : 0;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    auto& p = parameters[i];
    if (!p.grad().defined()) continue;
    const auto gradient = p.grad() * factor;
    first[i].mul_(config.beta1).add_(gradient, 1 - config.beta1);
    second[i].mul_(config.beta2).addcmul_(gradient, gradient, 1 - config.beta2);
    const auto deviation = (second[i] / correction2).sqrt_().add_(config.epsilon);
    p.addcdiv_(first[i], deviation, -learning_rate / correction1);
    average[i].mul_(decay).add_(p, 1 - decay);
    p.mutable_grad() = torch::Tensor();
  }
  return norm;
}

}  // namespace pleat::superres
