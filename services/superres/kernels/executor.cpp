#include "services/superres/kernels/executor.hpp"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "services/superres/kernels/team.hpp"

namespace pleat::superres::kernels {
namespace {

/// Which is faster lately: one thread or all.
class Pace {
 public:
  /// For the next image.
  bool alone() {
    if (turn_ < 2) return turn_++ == 1;  // each once, to begin with
    const bool better = alone_ms_ < together_ms_;
    return ++turn_ % kTry == 0 ? !better : better;
  }
  void took(bool alone, double ms) {
    double& known = alone ? alone_ms_ : together_ms_;
    known = known > 0 ? known + kMemory * (ms - known) : ms;
  }

 private:
  static constexpr int kTry = 24;  ///< images between two trials of what is slower
  static constexpr double kMemory = 0.3;
  int turn_ = 0;
  double alone_ms_ = 0, together_ms_ = 0;
};

/// Everything that depends on the size of the image.
struct Plan {
  Plan(const Description& network, Size input, const ExecutorOptions& options)
      : size(input),
        net(network, input, options.bfloat16, options.base_instructions),
        memory(net, true),
        tiles(make_tiles(net)) {}

  Size size;
  Net net;
  Memory memory;
  Buffer tiles;
  std::vector<Scratch> scratch;      ///< one a member
  const float* constants = nullptr;  ///< those that the input holds
};

}  // namespace

struct Executor::State {
  Description network;
  FindValues parameters;
  ExecutorOptions options;
  Team team;
  Pace pace;
  std::optional<Plan> plan;

  State(const Description& n, FindValues p, const ExecutorOptions& o)
      : network(n), parameters(std::move(p)), options(o), team(o.threads) {}

  void make_plan(Size size) {
    plan.emplace(network, size, options);
    plan->net.load(parameters);
    for (int member = 0; member < team.largest(); ++member) plan->scratch.emplace_back(plan->net);
  }

  void run_member(int member, const float* frames, std::span<const float> constants, int channels, float* output) {
    const Net& net = plan->net;
    const auto rows = [&](int value) { return Rows(net.geometry(value), member, team.members()); };
    const int plane = plan->size.height * plan->size.width;
    const int constant = static_cast<int>(constants.size()) / plane, own = network.inputs - constant;
    if (constant > 0 && plan->constants != constants.data()) {
      read_input(net, plan->memory, constants.data(), own, constant, rows(0));
    }
    read_input(net, plan->memory, frames, 0, own, rows(0));
    for (int i = 0; i < net.layers(); ++i) {
      if (reads_neighbours(net.network.layers[static_cast<std::size_t>(i)])) team.barrier();
      run_layer(net, i, plan->memory, plan->tiles, plan->scratch[static_cast<std::size_t>(member)], rows(i + 1));
    }
    write_answer(net, plan->memory, channels, output, rows(net.layers()));
  }
};

bool Executor::supports(const Description& network) {
  return std::all_of(network.layers.begin(), network.layers.end(), [&](const Layer& layer) {
    if (!is_image_layer(layer)) return false;
    return std::max(network.input_channels(layer), layer.channels) <= 2 * kLargestOutputs &&
           (layer.kernel == 3 || layer.channels <= kLargestOutputs);
  });
}

Executor::Executor(const Description& network, FindValues parameters, const ExecutorOptions& options)
    : state_(std::make_unique<State>(network, std::move(parameters), options)) {
  state_->make_plan({8, 8});
}

Executor::~Executor() = default;

const char* Executor::kernels() const { return state_->plan->net.body->name; }

void Executor::run(const float* frames, std::span<const float> constants, Size size, int channels, float* output) {
  State& s = *state_;
  if (s.plan->size != size) s.make_plan(size);
  const bool alone = s.team.largest() == 1 || s.pace.alone();
  const auto start = std::chrono::steady_clock::now();
  s.team.run([&](int member) { s.run_member(member, frames, constants, channels, output); }, alone);
  const std::chrono::duration<double, std::milli> taken = std::chrono::steady_clock::now() - start;
  s.plan->constants = constants.data();
  s.pace.took(alone, taken.count());
}

}  // namespace pleat::superres::kernels
