#include "services/superres/kernels/token_executor.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"

namespace pleat::superres::kernels {
namespace {

using Eigen::Index;
using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Row = Eigen::Array<float, 1, Eigen::Dynamic>;
/// Channels by places, as tensors lie in memory.
using Planes = Eigen::Map<Matrix>;
using ConstPlanes = Eigen::Map<const Matrix>;

constexpr Index kColumns = 64;     // places that are worked on at once: they stay in the cache
constexpr float kEpsilon = 1e-5F;  // of norms, as LibTorch's
constexpr float kLeak = 0.02F;     // of Activation::kLeakyRelu
constexpr float kHidden = -1e9F;   // score of a frame that may not be seen

bool is_view(LayerKind kind) { return kind == LayerKind::kPart || kind == LayerKind::kReshape; }

bool moves_values(LayerKind kind) {
  return is_view(kind) || kind == LayerKind::kPixelShuffle || kind == LayerKind::kUnshuffle ||
         kind == LayerKind::kJoin || kind == LayerKind::kMemory;
}

std::vector<bool> needed(const Description& network) {
  std::vector<int> wanted{network.values() - 1};
  if (network.remembers()) wanted.push_back(network.memory);
  return network.needed(wanted);
}

/// (out, inputs each) to (each, inputs out): Layer::tied.
Matrix transposed(const Matrix& weight, Index inputs) {
  const Index out = weight.rows(), each = weight.cols() / inputs;
  Matrix result(each, inputs * out);
  for (Index i = 0; i < inputs; ++i) {
    result.middleCols(i * out, out) = weight.middleCols(i * each, each).transpose();
  }
  return result;
}

struct Parameters {
  Matrix weight;
  Eigen::VectorXf bias, slope;  ///< weight and bias of a norm: `slope` and `bias`
};

std::vector<float> values_of(const FindValues& find, const std::string& name, std::size_t count) {
  const std::span<const float> values = find(name);
  if (values.size() != count) {
    throw_invalid_argument("parameter " + name + ": " + std::to_string(values.size()) + " values instead of " +
                           std::to_string(count));
  }
  return {values.begin(), values.end()};
}

Parameters load(const Description& network, const Layer& layer, const FindValues& find) {
  Parameters p;
  const auto vector = [&](const std::string& name, int count) {
    const auto values = values_of(find, name, static_cast<std::size_t>(count));
    return Eigen::VectorXf(Eigen::Map<const Eigen::VectorXf>(values.data(), count));
  };
  const int out = layer.channels / layer.frames;
  if (layer.kind == LayerKind::kNorm) {
    p.slope = vector(layer.name + "_weight", out);
    p.bias = vector(layer.name + "_bias", out);
  }
  if (layer.kind != LayerKind::kConvolution) return p;
  const int in = network.input_channels(layer) / layer.frames, count = static_cast<int>(layer.inputs.size());
  // A tied layer's weights belong to one that has as many outputs as this one has inputs, of one value.
  const int rows = layer.tied.empty() ? out : in / count, columns = layer.tied.empty() ? in : out * count;
  const auto values = values_of(find, (layer.tied.empty() ? layer.name : layer.tied) + "_weight", times(rows, columns));
  p.weight = ConstPlanes(values.data(), rows, columns);
  if (!layer.tied.empty()) p.weight = transposed(p.weight, count);
  p.bias = vector(layer.name + "_bias", out);
  if (layer.activation == Activation::kPrelu) p.slope = vector(layer.name + "_slope", out);
  return p;
}

template <typename Block>
void activate(Activation activation, const Eigen::VectorXf& slope, Block&& y) {
  switch (activation) {
    case Activation::kNone:
      return;
    case Activation::kRelu:
      y = y.cwiseMax(0.0F);
      return;
    case Activation::kPrelu:
      for (Index c = 0; c < y.rows(); ++c) y.row(c) = y.row(c).cwiseMax(0.0F) + slope[c] * y.row(c).cwiseMin(0.0F);
      return;
    case Activation::kTanh:
      y = y.array().tanh().matrix();
      return;
    case Activation::kLeakyRelu:
      y = y.cwiseMax(0.0F) + kLeak * y.cwiseMin(0.0F);
      return;
  }
}

}  // namespace

struct TokenExecutor::State {
  Description network;
  std::vector<bool> used;              ///< by layers
  std::vector<Parameters> parameters;  ///< by layers
  ThreadPool pool;
  // By values, for images of `size`.
  Size size;
  std::vector<Size> sizes;
  std::vector<std::vector<float>> own;
  std::vector<const float*> at;  ///< own, or the part of another value that a value is
  std::vector<float> zeros;

  State(const Description& n, const FindValues& find, int threads)
      : network(n), used(needed(n)), pool(static_cast<std::size_t>(std::max(1, threads))) {
    for (std::size_t i = 0; i < network.layers.size(); ++i) {
      parameters.push_back(used[i] ? load(network, network.layers[i], find) : Parameters{});
    }
  }

  Index places(int value) const {
    const Size& s = sizes[static_cast<std::size_t>(value)];
    return static_cast<Index>(s.height) * s.width;
  }
  /// `rows` channels of a value from `first` on.
  ConstPlanes planes(int value, Index first, Index rows) const {
    return {at[static_cast<std::size_t>(value)] + first * places(value), rows, places(value)};
  }
  Planes made(int value, Index first, Index rows) {
    return {own[static_cast<std::size_t>(value)].data() + first * places(value), rows, places(value)};
  }

  void make_buffers(Size input) {
    size = input;
    sizes = network.sizes(input);
    own.assign(sizes.size(), {});
    at.assign(sizes.size(), nullptr);
    own[0].resize(static_cast<std::size_t>(network.inputs * places(0)));
    at[0] = own[0].data();
    for (std::size_t i = 0; i < network.layers.size(); ++i) {
      const Layer& layer = network.layers[i];
      if (!used[i]) continue;
      if (is_view(layer.kind) || layer.kind == LayerKind::kMemory) continue;
      own[i + 1].resize(static_cast<std::size_t>(layer.channels * places(static_cast<int>(i) + 1)));
      at[i + 1] = own[i + 1].data();
    }
  }

  /// body(first place, places) over all places, by several threads where that is worth their waking up.
  void over_places(Index count, Index work_each, const std::function<void(Index, Index)>& body) {
    constexpr Index kWorthThreads = 1'000'000;  // multiplications
    const auto block = [&](std::size_t begin, std::size_t end) {
      for (auto b = static_cast<Index>(begin); b < static_cast<Index>(end); ++b) {
        body(b * kColumns, std::min(kColumns, count - b * kColumns));
      }
    };
    const auto blocks = static_cast<std::size_t>((count + kColumns - 1) / kColumns);
    if (pool.size() > 1 && count * work_each > kWorthThreads) {
      pool.parallel_for(blocks, 1, block);
    } else {
      block(0, blocks);
    }
  }

  void convolution(const Layer& layer, const Parameters& p, int value) {
    const Index out = layer.channels / layer.frames;
    over_places(places(value), layer.channels * p.weight.cols(), [&](Index first, Index count) {
      for (int t = 0; t < layer.frames; ++t) {
        auto y = made(value, t * out, out).middleCols(first, count);
        y = p.bias.replicate(1, count);
        if (layer.add >= 0) y += planes(layer.add, t * out, out).middleCols(first, count);
        Index column = 0;
        for (const int input : layer.inputs) {
          const Index in = network.channels(input) / layer.frames;
          y.noalias() += p.weight.middleCols(column, in) * planes(input, t * in, in).middleCols(first, count);
          column += in;
        }
        activate(layer.activation, p.slope, y);
      }
    });
  }

  void norm(const Layer& layer, const Parameters& p, int value) {
    const Index channels = layer.channels / layer.frames;
    const float share = 1.0F / static_cast<float>(channels);
    over_places(places(value), layer.channels, [&](Index first, Index count) {
      for (int t = 0; t < layer.frames; ++t) {
        const auto x = planes(layer.inputs[0], t * channels, channels).middleCols(first, count);
        auto y = made(value, t * channels, channels).middleCols(first, count);
        const Row mean = x.colwise().sum().array() * share;
        y = x.rowwise() - mean.matrix();
        const Row inverse = (y.colwise().squaredNorm().array() * share + kEpsilon).rsqrt();
        for (Index c = 0; c < channels; ++c) {
          y.row(c) = (y.row(c).array() * inverse * p.slope[c] + p.bias[c]).matrix();
        }
        if (layer.add >= 0) y += planes(layer.add, t * channels, channels).middleCols(first, count);
      }
    });
  }

  /// Queries, keys (1) or values (2) of a frame and a head, (width, places).
  ConstPlanes attended(const Layer& layer, int part, int frame, int head) const {
    const Index width = layer.channels / (layer.frames * layer.heads);
    const bool own_queries = layer.inputs.size() > 1;
    const int value = layer.inputs[own_queries && part > 0 ? 1 : 0];
    const int parts = !own_queries ? 3 : part > 0 ? 2 : 1, index = own_queries && part > 0 ? part - 1 : part;
    return planes(value, (static_cast<Index>(frame * parts + index) * layer.heads + head) * width, width);
  }

  void between_places(const Layer& layer, int value) {
    const Index width = layer.channels / (layer.frames * layer.heads);
    const float scale = 1 / std::sqrt(static_cast<float>(width));
    const Index keys = places(layer.inputs.back());
    over_places(places(value), 2 * layer.channels * keys, [&](Index first, Index count) {
      Matrix scores(keys, count);
      for (int t = 0; t < layer.frames; ++t) {
        for (int h = 0; h < layer.heads; ++h) {
          scores.noalias() = attended(layer, 1, t, h).transpose() * attended(layer, 0, t, h).middleCols(first, count);
          const Row most = scores.colwise().maxCoeff().array() * scale;
          Row sum = Row::Zero(count);
          for (Index k = 0; k < keys; ++k) {
            scores.row(k) = (scores.row(k).array() * scale - most).exp().matrix();
            sum += scores.row(k).array();
          }
          auto y = made(value, (static_cast<Index>(t) * layer.heads + h) * width, width).middleCols(first, count);
          y.noalias() = attended(layer, 2, t, h) * scores;
          y.array().rowwise() /= sum;
        }
      }
    });
  }

  void between_frames(const Layer& layer, int value) {
    const int frames = layer.frames;
    const Index width = layer.channels / (frames * layer.heads);
    const float scale = 1 / std::sqrt(static_cast<float>(width));
    over_places(places(value), 2 * layer.channels * frames, [&](Index first, Index count) {
      std::vector<Row> weights(static_cast<std::size_t>(frames));
      for (int h = 0; h < layer.heads; ++h) {
        for (int t = 0; t < frames; ++t) {
          const auto q = attended(layer, 0, t, h).middleCols(first, count);
          Row most = Row::Constant(count, kHidden), sum = Row::Zero(count);
          for (int s = 0; s < frames; ++s) {
            Row& score = weights[static_cast<std::size_t>(s)];
            score = q.cwiseProduct(attended(layer, 1, s, h).middleCols(first, count)).colwise().sum().array() * scale;
            if (layer.causal && s > t) score += kHidden;
            most = most.max(score);
          }
          auto y = made(value, (static_cast<Index>(t) * layer.heads + h) * width, width).middleCols(first, count);
          y.setZero();
          for (int s = 0; s < frames; ++s) {
            const Row weight = (weights[static_cast<std::size_t>(s)] - most).exp();
            sum += weight;
            y.array() += attended(layer, 2, s, h).middleCols(first, count).array().rowwise() * weight;
          }
          y.array().rowwise() /= sum;
        }
      }
    });
  }

  /// (f^2 C, h, w) and (C, f h, f w): kPixelShuffle, and backwards kUnshuffle.
  void shuffle(const Layer& layer, int value, bool back) {
    const int f = layer.factor, packed = back ? value : layer.inputs[0];
    const Size small = sizes[static_cast<std::size_t>(packed)];
    const int channels = (back ? layer.channels : network.channels(packed)) / (f * f);
    const float* from = at[static_cast<std::size_t>(layer.inputs[0])];
    float* to = own[static_cast<std::size_t>(value)].data();
    std::size_t p = 0;
    for (int c = 0; c < channels; ++c) {
      for (int i = 0; i < f; ++i) {
        for (int j = 0; j < f; ++j) {
          for (int y = 0; y < small.height; ++y) {
            const std::size_t row = times(c * small.height + y, f) + static_cast<std::size_t>(i);
            std::size_t large = row * times(small.width, f) + static_cast<std::size_t>(j);
            for (int x = 0; x < small.width; ++x, ++p, large += static_cast<std::size_t>(f)) {
              (back ? to[p] : to[large]) = back ? from[large] : from[p];
            }
          }
        }
      }
    }
  }

  void join(const Layer& layer, int value) {
    float* to = own[static_cast<std::size_t>(value)].data();
    for (const int input : layer.inputs) {
      to = std::copy_n(at[static_cast<std::size_t>(input)], network.channels(input) * places(input), to);
    }
  }

  void run_layer(std::size_t i, const TokenMemory& memory) {
    const Layer& layer = network.layers[i];
    const int value = static_cast<int>(i) + 1;
    switch (layer.kind) {
      case LayerKind::kConvolution:
        return convolution(layer, parameters[i], value);
      case LayerKind::kNorm:
        return norm(layer, parameters[i], value);
      case LayerKind::kAttention:
        return layer.over_frames ? between_frames(layer, value) : between_places(layer, value);
      case LayerKind::kPixelShuffle:
        return shuffle(layer, value, false);
      case LayerKind::kUnshuffle:
        return shuffle(layer, value, true);
      case LayerKind::kJoin:
        return join(layer, value);
      case LayerKind::kMemory:
        zeros.resize(static_cast<std::size_t>(layer.channels * places(value)));
        at[i + 1] = memory.before.empty() ? zeros.data() : memory.before.data();
        return;
      case LayerKind::kPart:
      case LayerKind::kReshape:
        at[i + 1] = at[static_cast<std::size_t>(layer.inputs[0])] + layer.first * places(layer.inputs[0]);
        return;
      default:
        throw_internal("token executor: layer " + layer.name);  // supports() is false
    }
  }

  void remember(const TokenMemory& memory) {
    if (memory.after == nullptr || !network.remembers()) return;
    const auto each = static_cast<std::size_t>(network.channels(network.memory) * places(network.memory));
    const std::size_t kept = each * static_cast<std::size_t>(network.remembered - 1);
    std::vector<float> after(kept + each, 0.0F);
    if (!memory.before.empty()) std::copy_n(memory.before.data() + each, kept, after.data());
    std::copy_n(at[static_cast<std::size_t>(network.memory)], each, after.data() + kept);
    const auto limit = static_cast<float>(kMemoryLimit);
    for (float& v : after) v = std::clamp(v, -limit, limit);
    memory.after->swap(after);
  }
};

bool TokenExecutor::supports(const Description& network) {
  const std::vector<bool> used = needed(network);
  for (std::size_t i = 0; i < network.layers.size(); ++i) {
    const Layer& layer = network.layers[i];
    const bool known = layer.kind == LayerKind::kConvolution
                           ? layer.kernel == 1 && layer.exact
                           : (layer.kind == LayerKind::kNorm && layer.exact) || layer.kind == LayerKind::kAttention ||
                                 moves_values(layer.kind);
    if (used[i] && !known) return false;
  }
  return true;
}

TokenExecutor::TokenExecutor(const Description& network, const FindValues& parameters, int threads)
    : state_(std::make_unique<State>(network, parameters, threads)) {}

TokenExecutor::~TokenExecutor() = default;

void TokenExecutor::run(const float* frames, std::span<const float> constants, Size size, int channels, float* output,
                        const TokenMemory& memory) {
  State& s = *state_;
  if (s.size != size) s.make_buffers(size);
  const std::size_t all = s.own[0].size(), given = all - constants.size();
  std::copy_n(frames, given, s.own[0].data());
  std::copy(constants.begin(), constants.end(), s.own[0].data() + given);
  if (!memory.before.empty() && s.network.remembers()) {
    const auto [c, h, w] = s.network.memory_shape(size);
    if (memory.before.size() != times(c, h) * static_cast<std::size_t>(w)) {
      throw_invalid_argument("memory: " + std::to_string(memory.before.size()) + " values");
    }
  }
  for (std::size_t i = 0; i < s.network.layers.size(); ++i) {
    if (s.used[i]) s.run_layer(i, memory);
  }
  s.remember(memory);
  const int answer = s.network.values() - 1;
  std::copy_n(s.at[static_cast<std::size_t>(answer)], channels * s.places(answer), output);
}

}  // namespace pleat::superres::kernels
