// The published network against plain loops in double, its gradients against differences, and its TorchScript twin.
#include "services/superres/networks/published/published.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/script.h>

#include <cmath>
#include <functional>
#include <map>

#include "common/base/error.hpp"
#include "services/superres/networks/network.hpp"
#include "tests/support/errors.hpp"

namespace pleat::superres {
namespace {

constexpr int kFrames = 3, kFeatures = 2, kCorner = 5, kFaces = 2, kLatent = 4, kWidth = 6, kHeads = 2, kOutputs = 3;
constexpr int kConstants = 1, kScale = 2;
constexpr std::int64_t kCoarse = 4, kFine = 5;

PlaceMap map_of(std::int64_t columns, const std::vector<std::vector<std::int64_t>>& rows) {
  PlaceMap map;
  map.columns = columns;
  for (const auto& row : rows) map.add(row);
  return map;
}

/// Two triangles of four vertices; five fine vertices, one of which is read at two of eight places; one place is
/// padding.
std::shared_ptr<const MeshPorts> small_mesh() {
  auto mesh = std::make_shared<MeshPorts>();
  mesh->corners = 3;
  mesh->features = kFeatures;
  mesh->coarse = map_of(3 * kFaces, {{0}, {2}, {4}, {5}});
  mesh->coarse_ring = map_of(kCoarse, {{1, 2}, {0, 2, 3}, {0, 1, 3}, {1, 2}});
  mesh->fine = map_of(8, {{0}, {1, 4}, {2}, {5}, {7}});
  mesh->fine_ring = map_of(kFine, {{1}, {0, 2, 3}, {1, 4}, {1}, {2}});
  mesh->fine_read = map_of(kFine, {{0}, {1}, {2}, {}, {1}, {3}, {}, {4}});
  return mesh;
}

Ports small_ports() {
  Ports ports;
  ports.inputs = kFrames * 3 * kCorner + kConstants;
  ports.outputs = kOutputs;
  ports.scale = kScale;
  ports.window = kFrames;
  ports.constants = kConstants;
  ports.mesh = small_mesh();
  return ports;
}

Description small_published(const std::string& more = "") {
  return describe({"published", R"({"latent": 4, "features": 6, "heads": 2, "hidden": 5, "blocks": 1)" + more + "}"},
                  small_ports());
}

/// Weights that begin at zero get values, or they would hide everything before them.
Network network_of(const Description& description) {
  Network network(description, 5);
  const torch::NoGradGuard no_grad;
  for (auto [name, value] : network.parameters()) {
    if (value.abs().max().item<double>() == 0) {
      value.copy_(torch::linspace(-0.2, 0.3, value.numel()).view(value.sizes()));
    }
  }
  return network;
}

torch::Tensor example(std::vector<std::int64_t> shape, double phase) {
  std::int64_t count = 1;
  for (const std::int64_t extent : shape) count *= extent;
  return (0.6 * torch::sin(torch::arange(count, torch::kFloat32) * 0.37 + phase)).view(shape);
}

Network::Reads example_reads(std::int64_t batch = 1) {
  return {example({batch, kFrames * 3 * kCorner + kConstants, 1, kFaces}, 0),
          example({batch, kFrames * kLatent, 1, 1}, 1), example({batch, kOutputs, kScale, kScale * kFaces}, 2)};
}

using Row = std::vector<double>;  // of one vertex, token or code
using Rows = std::vector<Row>;

/// The network of one image as [DT-S] writes it, with nothing of ours but the weights.
class Plain {
 public:
  explicit Plain(const Network& network) {
    for (const auto& [name, value] : network.parameters()) {
      const auto flat = value.detach().contiguous().view({-1});
      for (std::int64_t i = 0; i < flat.numel(); ++i) values_[name].push_back(flat[i].item<double>());
    }
  }

  /// y_i = W_p x_i + W_n mean_j x_j + b; transposed: with the weights of `name` turned round and the bias of `bias`.
  Rows convolve(const Rows& x, const PlaceMap& ring, const std::string& name, bool transposed,
                const std::string& bias) const {
    const std::size_t channels = x[0].size();
    const Row &w = values_.at(name + "_weight"), &b = values_.at(bias + "_bias");
    Rows y(x.size(), Row(channels));
    for (std::size_t i = 0; i < x.size(); ++i) {
      Row mean(channels, 0);
      const auto first = static_cast<std::size_t>(ring.offsets[i]),
                 last = static_cast<std::size_t>(ring.offsets[i + 1]);
      for (std::size_t k = first; k < last; ++k) {
        for (std::size_t c = 0; c < channels; ++c) {
          mean[c] += x[static_cast<std::size_t>(ring.places[k])][c] / static_cast<double>(last - first);
        }
      }
      for (std::size_t o = 0; o < channels; ++o) {
        y[i][o] = b[o];
        for (std::size_t c = 0; c < channels; ++c) {
          const std::size_t own = transposed ? c * 2 * channels + o : o * 2 * channels + c;
          y[i][o] += w[own] * x[i][c] + w[own + channels] * mean[c];
        }
      }
    }
    return y;
  }

  static Rows each(Rows x, const std::function<double(double)>& function) {
    for (Row& row : x) {
      for (double& value : row) value = function(value);
    }
    return x;
  }
  static double tanh(double x) { return std::tanh(x); }

  /// The fully connected layer reads channel by channel, as a tensor (C, 1, V) lies.
  Row encode(const std::string& name, const Rows& features, const PlaceMap& ring, bool norm = false) const {
    Rows first = convolve(features, ring, name + "_first", false, name + "_first");
    first = each(first, norm ? [](double x) { return x > 0 ? x : 0.02 * x; } : tanh);
    if (norm) first = normalized(first, name + "_norm");
    const Rows second = convolve(first, ring, name + "_second", false, name + "_second");
    const Row &w = values_.at(name + "_latent_weight"), &b = values_.at(name + "_latent_bias");
    Row code = b;
    const std::size_t channels = second[0].size(), vertices = second.size();
    for (std::size_t k = 0; k < code.size(); ++k) {
      for (std::size_t c = 0; c < channels; ++c) {
        for (std::size_t v = 0; v < vertices; ++v) {
          code[k] += w[k * channels * vertices + c * vertices + v] * second[v][c];
        }
      }
    }
    return code;
  }

  Rows decode(const std::string& name, const Row& code, const PlaceMap& ring, std::size_t channels,
              bool linear = false) const {
    const std::size_t vertices = ring.offsets.size() - 1;
    const Row &w = values_.at(name + "_latent_weight"), &b = values_.at(name + "_again_bias");
    Rows x(vertices, Row(channels));
    for (std::size_t v = 0; v < vertices; ++v) {
      for (std::size_t c = 0; c < channels; ++c) {
        x[v][c] = b[c * vertices + v];
        for (std::size_t k = 0; k < code.size(); ++k) {
          x[v][c] += w[k * channels * vertices + c * vertices + v] * code[k];
        }
      }
    }
    x = each(convolve(x, ring, name + "_second", true, name + "_second_again"), tanh);
    x = convolve(x, ring, name + "_first", true, name + "_first_again");
    return linear ? x : each(x, tanh);
  }

  /// W x + b for every row.
  Rows map(const Rows& x, const std::string& name) const {
    const Row &w = values_.at(name + "_weight"), &b = values_.at(name + "_bias");
    Rows y(x.size(), b);
    for (std::size_t i = 0; i < x.size(); ++i) {
      for (std::size_t o = 0; o < b.size(); ++o) {
        for (std::size_t c = 0; c < x[i].size(); ++c) y[i][o] += w[o * x[i].size() + c] * x[i][c];
      }
    }
    return y;
  }

  Rows normalized(Rows x, const std::string& name) const {
    const Row &w = values_.at(name + "_weight"), &b = values_.at(name + "_bias");
    for (Row& row : x) {
      double mean = 0, variance = 0;
      for (const double v : row) mean += v / static_cast<double>(row.size());
      for (const double v : row) variance += (v - mean) * (v - mean) / static_cast<double>(row.size());
      for (std::size_t c = 0; c < row.size(); ++c) row[c] = (row[c] - mean) / std::sqrt(variance + 1e-5) * w[c] + b[c];
    }
    return x;
  }

  /// tokens[t][n]: frame t, number n.
  using Tokens = std::vector<Rows>;

  Tokens embedded(const std::vector<Row>& codes, const std::string& name) const {
    const Row &w = values_.at(name + "_weight"), &b = values_.at(name + "_bias"), &time = values_.at(name + "_time");
    Tokens tokens(kFrames, Rows(kLatent, Row(kWidth)));
    for (std::size_t t = 0; t < kFrames; ++t) {
      for (std::size_t n = 0; n < kLatent; ++n) {
        for (std::size_t c = 0; c < kWidth; ++c) {
          tokens[t][n][c] = codes[t][n] * w[c * kLatent + n] + b[c * kLatent + n] + time[t * kWidth + c];
        }
      }
    }
    return tokens;
  }

  /// softmax over who is seen, of q . k / sqrt(width of a head), times v.
  static Row look(const Row& query, const Rows& keys, const Rows& values) {
    Row result(kWidth, 0);
    const std::size_t width = kWidth / kHeads;
    for (std::size_t head = 0; head < kHeads; ++head) {
      Row score;
      double sum = 0;
      for (const Row& key : keys) {
        double dot = 0;
        for (std::size_t c = head * width; c < (head + 1) * width; ++c) dot += query[c] * key[c];
        score.push_back(std::exp(dot / std::sqrt(static_cast<double>(width))));
        sum += score.back();
      }
      for (std::size_t s = 0; s < keys.size(); ++s) {
        for (std::size_t c = head * width; c < (head + 1) * width; ++c) result[c] += score[s] / sum * values[s][c];
      }
    }
    return result;
  }

  static Rows cut(const Rows& x, std::size_t first) {
    Rows result;
    for (const Row& row : x) {
      const auto begin = row.begin() + static_cast<std::ptrdiff_t>(first);
      result.emplace_back(begin, begin + kWidth);
    }
    return result;
  }

  /// Attention of tokens to others (themselves: `own`), added and normalised.
  Tokens seen(const Tokens& tokens, const Tokens& others, const std::string& name, bool over_frames, bool causal,
              bool own) const {
    Tokens result(kFrames, Rows(kLatent));
    std::vector<Rows> queries, keys, values;
    for (std::size_t t = 0; t < kFrames; ++t) {
      if (own) {
        const Rows parts = map(tokens[t], name + "_parts");
        queries.push_back(cut(parts, 0)), keys.push_back(cut(parts, kWidth)), values.push_back(cut(parts, 2 * kWidth));
      } else {
        queries.push_back(map(tokens[t], name + "_queries"));
        const Rows parts = map(others[t], name + "_others");
        keys.push_back(cut(parts, 0)), values.push_back(cut(parts, kWidth));
      }
    }
    for (std::size_t t = 0; t < kFrames; ++t) {
      for (std::size_t n = 0; n < kLatent; ++n) {
        Rows k = keys[t], v = values[t];
        if (over_frames) {
          k.clear(), v.clear();
          for (std::size_t s = 0; s < (causal ? t + 1 : kFrames); ++s)
            k.push_back(keys[s][n]), v.push_back(values[s][n]);
        }
        result[t][n] = look(queries[t][n], k, v);
      }
      result[t] = normalized(add(map(result[t], name + "_mix"), tokens[t]), name + "_norm");
    }
    return result;
  }

  static Rows add(Rows a, const Rows& b) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      for (std::size_t c = 0; c < a[i].size(); ++c) a[i][c] += b[i][c];
    }
    return a;
  }
  static Tokens sum(Tokens a, const Tokens& b) {
    for (std::size_t t = 0; t < a.size(); ++t) a[t] = add(a[t], b[t]);
    return a;
  }
  Tokens perceptron(const Tokens& tokens, const std::string& name) const {
    Tokens result;
    for (const Rows& rows : tokens) {
      const Rows hidden = each(map(rows, name + "_hidden"), [](double x) { return std::max(x, 0.0); });
      result.push_back(normalized(add(map(hidden, name + "_out"), rows), name + "_norm"));
    }
    return result;
  }

  /// The next code, of what the coarse frames' codes and its own last ones are.
  Row next(const std::vector<Row>& coarse, const std::vector<Row>& own) const {
    const Tokens c = embedded(coarse, "coarse_tokens"), o = embedded(own, "own_tokens");
    const Tokens read = perceptron(
        sum(seen(c, c, "encoder0_spatial", false, false, true), seen(c, c, "encoder0_temporal", true, false, true)),
        "encoder0");
    Tokens all = seen(o, o, "decoder0_own", true, true, true);
    all = sum(all, seen(o, read, "decoder0_spatial", false, false, false));
    all = sum(all, seen(o, read, "decoder0_temporal", true, false, false));
    const Rows more = map(perceptron(all, "decoder0")[kFrames - 1], "next");
    Row code = own[kFrames - 1];
    for (std::size_t n = 0; n < code.size(); ++n) code[n] += more[n][0];
    return code;
  }

 private:
  std::map<std::string, Row> values_;
};

double at(const torch::Tensor& t, std::initializer_list<std::int64_t> place) {
  torch::Tensor value = t;
  for (const std::int64_t i : place) value = value[i];
  return value.item<double>();
}

/// Features of the coarse vertices of frame t, out of the corners that hold them.
Rows coarse_features(const torch::Tensor& x, const MeshPorts& mesh, int t) {
  Rows rows;
  for (const std::int64_t place : mesh.coarse.places) {
    Row row;
    for (int c = 0; c < kFeatures; ++c) {
      row.push_back(at(x, {0, (t * 3 + place / kFaces) * kCorner + c, 0, place % kFaces}));
    }
    rows.push_back(row);
  }
  return rows;
}

class PublishedTest : public testing::TestWithParam<const char*> {};

TEST_P(PublishedTest, AgreesWithPlainLoops) {
  const std::string options = GetParam();
  const bool norm = options.find("layer") != std::string::npos, linear = options.find("linear") != std::string::npos;
  const Network network = network_of(small_published(options));
  const Description& d = network.description();
  const Plain plain(network);
  const Network::Reads reads = example_reads();
  const auto mesh = small_mesh();
  const auto values = network.values(
      reads, {d.values() - 1, d.memory, d.given_memory, d.twins[0].out, d.twins[0].in, d.twins[1].in, d.reconstructed});

  std::vector<Row> coarse, own;
  for (int t = 0; t < kFrames; ++t) {
    const Rows features = coarse_features(reads.x, *mesh, t);
    coarse.push_back(plain.encode("coarse", features, mesh->coarse_ring, norm));
    const Rows again = plain.decode("coarse", coarse.back(), mesh->coarse_ring, kFeatures, linear);
    for (std::int64_t v = 0; v < kCoarse; ++v) {
      for (int c = 0; c < kFeatures; ++c) {
        const auto row = static_cast<std::size_t>(v), column = static_cast<std::size_t>(c);
        EXPECT_NEAR(at(values[4], {0, t * kFeatures + c, 0, v}), features[row][column], 1e-6);
        EXPECT_NEAR(at(values[3], {0, t * kFeatures + c, 0, v}), again[row][column], 1e-5);
      }
    }
    Row code;
    for (int n = 0; n < kLatent; ++n) code.push_back(at(reads.memory, {0, t * kLatent + n, 0, 0}));
    own.push_back(code);
  }
  const Row next = plain.next(coarse, own);
  for (std::size_t n = 0; n < next.size(); ++n) {
    EXPECT_NEAR(at(values[1], {0, static_cast<std::int64_t>(n), 0, 0}), next[n], 2e-5) << n;
  }

  // A fine vertex is the mean of the places where an answer holds it, and an answer holds it at all of them.
  Rows fine(kFine, Row(kOutputs, 0));
  const auto expect_answer = [&](const torch::Tensor& answer, const Rows& rows) {
    for (std::int64_t place = 0; place < 8; ++place) {
      const auto first = static_cast<std::size_t>(mesh->fine_read.offsets[static_cast<std::size_t>(place)]);
      const bool padding =
          mesh->fine_read.offsets[static_cast<std::size_t>(place) + 1] == static_cast<std::int64_t>(first);
      for (int c = 0; c < kOutputs; ++c) {
        const double expected =
            padding ? 0 : rows[static_cast<std::size_t>(mesh->fine_read.places[first])][static_cast<std::size_t>(c)];
        EXPECT_NEAR(at(answer, {0, c, place / 4, place % 4}), expected, 2e-5) << place;
      }
    }
  };
  expect_answer(values[0], plain.decode("fine", next, mesh->fine_ring, kOutputs, linear));
  for (std::size_t v = 0; v < kFine; ++v) {
    for (int c = 0; c < kOutputs; ++c) {
      const auto first = mesh->fine.offsets[v], last = mesh->fine.offsets[v + 1];
      for (auto k = first; k < last; ++k) {
        const std::int64_t place = mesh->fine.places[static_cast<std::size_t>(k)];
        fine[v][static_cast<std::size_t>(c)] +=
            at(reads.given, {0, c, place / 4, place % 4}) / static_cast<double>(last - first);
      }
      EXPECT_NEAR(at(values[5], {0, c, 0, static_cast<std::int64_t>(v)}), fine[v][static_cast<std::size_t>(c)], 1e-6);
    }
  }
  const Row given = plain.encode("fine", fine, mesh->fine_ring, norm);
  for (std::size_t n = 0; n < given.size(); ++n) {
    EXPECT_NEAR(at(values[2], {0, static_cast<std::int64_t>(n), 0, 0}), given[n], 1e-5);
  }
  expect_answer(values[6], plain.decode("fine", given, mesh->fine_ring, kOutputs, linear));
}

TEST_P(PublishedTest, TheScriptIsTheSameFunction) {
  const Network network = network_of(small_published(GetParam()));
  const Description& d = network.description();
  auto module = network.to_script();
  const Network::Reads reads = example_reads(2);
  const auto values = network.values(reads, {d.values() - 1, d.memory});
  const auto both = module.forward({reads.x, reads.memory}).toTuple();
  EXPECT_LT((both->elements()[0].toTensor() - values[0]).abs().max().item<double>(), 1e-5);
  const auto after = both->elements()[1].toTensor(), expected = network.remember(reads.memory, values[1]);
  ASSERT_EQ(after.sizes(), expected.sizes());
  EXPECT_LT((after - expected).abs().max().item<double>(), 1e-5);
  // The oldest frame is forgotten.
  EXPECT_TRUE(after.slice(1, 0, 2 * kLatent).equal(reads.memory.slice(1, kLatent)));
  // What training alone needs is no part of it.
  for (const auto& parameter : module.named_parameters())
    EXPECT_EQ(parameter.name.find("coarse_again"), std::string::npos);
}

/// d(loss)/d(parameter) against central differences of the loss, some entries of every parameter. Where those of two
/// steps differ there is a kink between (leaky ReLU, norms of two channels), and they say nothing.
TEST_P(PublishedTest, GradientsAreDifferences) {
  const Network network = network_of(small_published(GetParam()));
  const Description& d = network.description();
  const Network::Reads reads = example_reads(2);
  const auto loss = [&] {
    const auto v = network.values(reads, {d.values() - 1, d.memory, d.twins[0].out, d.twins[1].out});
    auto sum = torch::zeros({}, torch::kFloat64);
    double phase = 0;
    for (const auto& value : v) sum = sum + (value * example(value.sizes().vec(), phase += 1)).sum(torch::kFloat64);
    return sum;
  };
  loss().backward();
  const torch::NoGradGuard no_grad;
  int compared = 0, kinks = 0;
  for (auto [name, value] : network.parameters()) {
    ASSERT_TRUE(value.grad().defined()) << name;
    auto flat = value.view({-1});
    const auto gradient = value.grad().view({-1});
    for (std::int64_t i = 0; i < flat.numel(); i += std::max<std::int64_t>(1, flat.numel() / 3)) {
      const float before = flat[i].item<float>();
      const auto difference = [&](float step) {
        flat[i] = before + step;
        const double high = loss().item<double>();
        flat[i] = before - step;
        const double low = loss().item<double>();
        flat[i] = before;
        return (high - low) / (2 * static_cast<double>(step));
      };
      const double wide = difference(1e-2F), narrow = difference(4e-3F);
      if (std::abs(wide - narrow) > 2e-3 + 0.02 * std::abs(narrow)) {
        ++kinks;
        continue;
      }
      ++compared;
      EXPECT_NEAR(gradient[i].item<double>(), narrow, 3e-3 + 0.03 * std::abs(narrow)) << name << " " << i;
    }
  }
  EXPECT_GT(compared, 5 * kinks);
}

INSTANTIATE_TEST_SUITE_P(Forms, PublishedTest, testing::Values("", R"(, "norm": "layer", "output": "linear")"));

TEST(Published, WithoutTrainingItStaysWhereItWas) {
  const Network network(small_published(), 5);
  const Network::Reads reads = example_reads();
  const auto code = network.values(reads, {network.description().memory}).front();
  EXPECT_TRUE(code.flatten().equal(reads.memory.slice(1, 2 * kLatent).flatten()));
}

TEST(Published, ModulesCanBeSwitchedOff) {
  const auto has = [](const Description& d, const std::string& part) {
    return std::any_of(d.layers.begin(), d.layers.end(),
                       [&](const Layer& layer) { return layer.name.find(part) != std::string::npos; });
  };
  const Description plain = small_published(), flat = small_published(R"(, "spatial": false)"),
                    still = small_published(R"(, "temporal": false)");
  EXPECT_TRUE(has(plain, "_spatial") && has(plain, "_temporal") && has(plain, "_own"));
  EXPECT_TRUE(!has(flat, "_spatial") && has(flat, "_temporal"));
  EXPECT_TRUE(has(still, "_spatial") && !has(still, "_temporal") && !has(still, "_own_"));
  EXPECT_EQ(small_published(R"(, "latent": 8)").memory_shape({1, kFaces}), (std::array<int, 3>{3 * 8, 1, 1}));
}

TEST(Published, SizesAreThoseOfThePaper) {
  // 342 + 144 V each, of nine features and 16 numbers.
  auto mesh = std::make_shared<MeshPorts>(*small_mesh());
  mesh->features = 9;
  Ports ports = small_ports();
  ports.outputs = 9;
  ports.inputs = kFrames * 3 * 15;
  ports.constants = 0;
  ports.mesh = mesh;
  const Network network(describe({"published", "{}"}, ports), 1);
  std::int64_t autoencoders = 0, transformer = 0;
  for (const auto& [name, value] : network.parameters()) {
    const bool of_tokens = name.find("coarse_tokens") == 0;
    const bool weights = name.find("_weight") != std::string::npos;
    const bool biases = name.find("_bias") != std::string::npos;
    const bool own = (name.find("coarse_") == 0 || name.find("fine_") == 0) && !of_tokens;
    if (!own) transformer += value.numel();
    if (own &&
        (weights || (biases && name.find("latent") == std::string::npos && name.find("again") == std::string::npos))) {
      autoencoders += value.numel();
    }
  }
  EXPECT_EQ(autoencoders, 2 * 342 + 144 * (kCoarse + kFine));
  EXPECT_EQ(transformer, 305089);
}

/// Without meshes, as of a bundle's file, only the ends are known.
TEST(Published, WithoutMeshesTheEndsAreRight) {
  Ports ports = small_ports();
  ports.mesh = nullptr;
  const Description d = describe({"published", "{}"}, ports);
  EXPECT_EQ(d.outputs(), kOutputs);
  EXPECT_EQ(d.sizes({1, kFaces}).back(), (Size{kScale, kScale * kFaces}));
  EXPECT_THAT(test::error_of([&] {
                describe({"published", R"({"norm": "batch"})"}, ports);
              }).what(),
              testing::HasSubstr("norm"));
}

}  // namespace
}  // namespace pleat::superres
