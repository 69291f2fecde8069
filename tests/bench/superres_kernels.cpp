// Pleat's own convolutions against LibTorch's (oneDNN), for inference and for training, at the sizes that are used, on
// one thread. Prints processor time, which other work on the machine changes little; docs/decisions/0006-own-kernels.md
// has a table.
#include <torch/script.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/superres/kernels/executor.hpp"
#include "services/superres/kernels/kernels.hpp"
#include "services/superres/networks/network.hpp"
#include "services/superres/networks/registry.hpp"

namespace {

using namespace pleat::superres;

double processor_ms() {
  timespec t{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

double milliseconds(const std::function<void()>& work) {
  const double start = processor_ms();
  work();
  return processor_ms() - start;
}

struct Contender {
  std::string name;
  std::function<void()> work;
  bool ours = false;
  std::vector<double> ms = {};
};

/// One after the other, again and again, so that what else the machine does falls on all. Medians.
void compare(const std::string& title, std::vector<Contender> contenders, int rounds) {
  for (Contender& c : contenders) {
    for (int i = 0; i < 3; ++i) c.work();
  }
  for (int r = 0; r < rounds; ++r) {
    for (Contender& c : contenders) c.ms.push_back(milliseconds(c.work));
  }
  std::printf("%-44s", title.c_str());
  double own = 0, best = 1e30;
  for (Contender& c : contenders) {
    std::nth_element(c.ms.begin(), c.ms.begin() + rounds / 2, c.ms.end());
    const double median = c.ms[static_cast<std::size_t>(rounds / 2)];
    std::printf(" | %s %8.2f ms", c.name.c_str(), median);
    if (own == 0) own = median;
    if (!c.ours) best = std::min(best, median);
  }
  std::printf(" | %.2f times\n", best / own);
  std::fflush(stdout);
}

torch::jit::Module prepared(const Network& network, bool bfloat16, bool channels_last) {
  const torch::NoGradGuard no_grad;
  auto module = network.to_script();
  const auto exact = network.float32_parameters();
  for (const auto& entry : module.named_parameters()) {
    auto value = entry.value;
    const bool stays =
        std::any_of(exact.begin(), exact.end(), [&](const auto& p) { return entry.name.rfind(p, 0) == 0; });
    if (bfloat16 && !stays) value.set_data(value.to(torch::kBFloat16));
    if (channels_last && value.dim() == 4) value.set_data(value.contiguous(at::MemoryFormat::ChannelsLast));
  }
  module = torch::jit::freeze(module);
  return torch::jit::optimize_for_inference(module);
}

void inference(const std::string& title, const Network& network, const torch::Tensor& x, int rounds) {
  for (const bool bfloat16 : {false, true}) {
    if (bfloat16 && !kernels::has_bfloat16()) continue;
    const auto find = [&](const std::string& name) {
      for (const auto& [key, value] : network.parameters()) {
        if (key == name)
          return std::span<const float>(value.data_ptr<float>(), static_cast<std::size_t>(value.numel()));
      }
      return std::span<const float>();
    };
    kernels::Executor executor(network.description(), find, {bfloat16, 1, false});
    const Size size{static_cast<int>(x.size(2)), static_cast<int>(x.size(3))};
    const int channels = network.description().outputs();
    std::vector<float> answer(static_cast<std::size_t>(16 * channels * size.height * size.width));
    auto plain = prepared(network, bfloat16, false), last = prepared(network, bfloat16, true);
    const auto x_last = x.contiguous(at::MemoryFormat::ChannelsLast);
    const auto run = [](torch::jit::Module& module, const torch::Tensor& input) {
      const c10::InferenceMode guard;
      module.forward({input}).toTensor().contiguous();
    };
    std::vector<Contender> contenders{
        {"own", [&] { executor.run(x.data_ptr<float>(), {}, size, channels, answer.data()); }, true},
        {"LibTorch", [&] { run(plain, x); }},
        {"channels last", [&] { run(last, x_last); }}};
    std::optional<kernels::Executor> without_tiles;
    if (bfloat16 && kernels::has_tiles()) {
      without_tiles.emplace(network.description(), find, kernels::ExecutorOptions{bfloat16, 1, true});
      contenders.push_back({"own without tiles",
                            [&] { without_tiles->run(x.data_ptr<float>(), {}, size, channels, answer.data()); }, true});
    }
    compare(title + (bfloat16 ? ", bfloat16" : ", float32"), std::move(contenders), rounds);
  }
}

void training(const std::string& title, const Description& description, const torch::Tensor& x, int rounds) {
  for (const auto type : {torch::kFloat32, torch::kBFloat16}) {
    if (type == torch::kBFloat16 && !kernels::has_bfloat16()) continue;
    Network own(description, 1), other(description, 1);
    own.use_own_kernels(1);
    const auto step = [&](Network& network, const torch::Tensor& input) {
      network.forward(input, type).square().mean().backward();
      for (const auto& [name, value] : network.parameters()) value.mutable_grad() = torch::Tensor();
    };
    const auto last = x.contiguous(at::MemoryFormat::ChannelsLast);
    compare(title + (type == torch::kBFloat16 ? ", bfloat16" : ", float32"),
            {{"own", [&] { step(own, x); }, true},
             {"LibTorch", [&] { step(other, x); }},
             {"channels last", [&] { step(other, last); }}},
            rounds);
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Times of Pleat's own convolutions beside LibTorch's, one thread");
  int rounds = 20;
  app.add_option("rounds", rounds, "of each small case; large ones have a quarter (default: 20)")
      ->check(CLI::Range(1, 100000));
  CLI11_PARSE(app, argc, argv);
  const int few = std::max(3, rounds / 4);
  at::set_num_threads(1);
  const Description live =
      describe({"mfsr", R"({"blocks": 4, "layers": 4, "features": 32, "upsampling": "subpixel"})"}, {49, 3, 4, true});
  const Description residual =
      describe({"srresnet", R"({"blocks": 20, "features": 32, "upsampling": "subpixel"})"}, {49, 3, 4, true});
  const Description published = describe({"mfsr", "{}"}, {9, 9, 4, false});
  const auto image = [](std::int64_t n, std::int64_t channels) { return torch::rand({n, channels, 40, 60}); };
  inference("one image, live", Network(live, 1), image(1, 49), rounds);
  inference("one image, srresnet", Network(residual, 1), image(1, 49), rounds);
  inference("one image, published", Network(published, 1), image(1, 9), few);
  training("four images trained, live", live, image(4, 49), few);
  training("four images trained, srresnet", residual, image(4, 49), few);
  return 0;
}
