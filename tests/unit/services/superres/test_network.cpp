// The network against plain loops that share nothing with it but the weights, and its TorchScript twin.
#include <gtest/gtest.h>
#include <torch/script.h>

#include <cmath>
#include <map>

#include "common/base/error.hpp"
#include "services/superres/network.hpp"
#include "tests/unit/services/superres/example_network.hpp"

namespace pleat::superres {
namespace {

/// A stack of planes in double.
struct Image {
  int channels, height, width;
  std::vector<double> values;
  Image(int c, int h, int w) : channels(c), height(h), width(w), values(static_cast<std::size_t>(c * h * w)) {}
  double& at(int c, int y, int x) { return values[static_cast<std::size_t>((c * height + y) * width + x)]; }
  double at(int c, int y, int x) const { return values[static_cast<std::size_t>((c * height + y) * width + x)]; }
};

Image from_tensor(const torch::Tensor& t) {
  Image image(static_cast<int>(t.size(1)), static_cast<int>(t.size(2)), static_cast<int>(t.size(3)));
  const auto flat = t.detach().contiguous().view({-1});
  for (std::size_t i = 0; i < image.values.size(); ++i)
    image.values[i] = flat[static_cast<std::int64_t>(i)].item<double>();
  return image;
}

class Plain {
 public:
  explicit Plain(const Network& network) : a_(network.architecture()) {
    for (const auto& [name, value] : network.parameters()) {
      const auto flat = value.detach().contiguous().view({-1});
      auto& target = values_[name];
      for (std::int64_t i = 0; i < flat.numel(); ++i) target.push_back(flat[i].item<double>());
      outputs_[name] = static_cast<int>(value.size(0));
    }
    for (const auto& [name, value] : network.buffers()) {
      const auto flat = value.contiguous().view({-1});
      for (std::int64_t i = 0; i < flat.numel(); ++i) values_[name].push_back(flat[i].item<double>());
    }
  }

  Image forward(const Image& x) const {
    const Image input = a_.conditioned ? condition(x) : x;
    const Image shallow = convolve(input, "shallow0", 3);
    Image features = convolve(shallow, "shallow1", 3);
    std::vector<Image> blocks;
    if (a_.kind == "srresnet") features = residual_blocks(features);
    for (int d = 0; a_.kind == "mfsr" && d < a_.blocks; ++d) {
      const std::string block = "block" + std::to_string(d);
      Image stack = features;
      for (int c = 0; c < a_.layers; ++c) {
        Image layer = convolve(stack, block + "_dense" + std::to_string(c), 3);
        for (double& v : layer.values) v = std::max(v, 0.0);
        stack = join({stack, layer});
      }
      features = add(convolve(stack, block + "_fusion", 1), features);
      blocks.push_back(features);
    }
    if (a_.kind == "mfsr") features = convolve(join(blocks), "global0", 1);
    features = add(convolve(features, "global1", 3), shallow);
    if (a_.upsampling == "bilinear") features = upsample(features);
    Image out = join({convolve(features, "head_displacement", 3), convolve(features, "head_normal", 3),
                      convolve(features, "head_velocity", 3)});
    if (a_.upsampling == "subpixel") out = shuffle(out, 4);
    if (a_.conditioned) {
      for (int c = 0; c < kChannels; ++c) {
        for (int y = 0; y < out.height; ++y) {
          for (int x2 = 0; x2 < out.width; ++x2) out.at(c, y, x2) *= value("output_deviation", c);
        }
      }
    }
    return a_.residual == "bilinear" ? add(out, upsample(x)) : out;
  }

  /// Displacements of the network on positions.
  Image chen(const Image& x) const {
    double unit = 0;
    for (int c = 0; c < 3; ++c) unit += value("base_range", c) / 3;
    const auto rest = [&](int c, int texel) { return value("base_rest", c * x.height * x.width + texel); };
    Image positions(3, x.height, x.width);
    for (int c = 0; c < 3; ++c) {
      for (int i = 0; i < x.height * x.width; ++i) {
        const double d = x.at(c, i / x.width, i % x.width) * value("base_range", c) + value("base_minimum", c);
        positions.at(c, i / x.width, i % x.width) = (d + rest(c, i)) / unit;
      }
    }
    const Image shallow = prelu(convolve(positions, "shallow0", 3), "shallow0");
    Image features = add(convolve(residual_blocks(shallow), "global1", 3), shallow);
    for (const char* stage : {"stage0", "stage1"}) features = prelu(shuffle(convolve(features, stage, 3), 2), stage);
    Image out = convolve(features, "last", 3);
    const int fine = out.height * out.width;
    for (int c = 0; c < 3; ++c) {
      for (int i = 0; i < fine; ++i) {
        double fine_rest = 0.5;
        for (int k = 0; k < 3; ++k) {
          const int vertex = static_cast<int>(value("base_corners", k * fine + i));
          for (int j = 0; j < kNear; ++j) {
            const int texel = static_cast<int>(value("base_vertex_texels", vertex * kNear + j));
            fine_rest += value("base_weights", k * fine + i) * value("base_vertex_weights", vertex * kNear + j) *
                         (rest(c, texel) - 0.5);
          }
        }
        double& v = out.at(c, i / out.width, i % out.width);
        v = (v * unit - fine_rest - value("base_minimum", c)) / value("base_range", c);
      }
    }
    return out;
  }

 private:
  double value(const std::string& name, int i) const { return values_.at(name)[static_cast<std::size_t>(i)]; }

  Image convolve(const Image& x, const std::string& name, int kernel) const {
    const int out_channels = outputs_.at(name + "_weight"), half = kernel / 2;
    Image out(out_channels, x.height, x.width);
    for (int o = 0; o < out_channels; ++o) {
      for (int y = 0; y < x.height; ++y) {
        for (int column = 0; column < x.width; ++column) {
          double sum = value(name + "_bias", o);
          for (int i = 0; i < x.channels; ++i) {
            for (int dy = -half; dy <= half; ++dy) {
              for (int dx = -half; dx <= half; ++dx) {
                const int yy = y + dy, xx = column + dx;
                if (yy < 0 || xx < 0 || yy >= x.height || xx >= x.width) continue;
                sum += x.at(i, yy, xx) *
                       value(name + "_weight", ((o * x.channels + i) * kernel + dy + half) * kernel + dx + half);
              }
            }
          }
          out.at(o, y, column) = sum;
        }
      }
    }
    return out;
  }

  static Image join(const std::vector<Image>& parts) {
    int channels = 0;
    for (const Image& part : parts) channels += part.channels;
    Image out(channels, parts[0].height, parts[0].width);
    out.values.clear();
    for (const Image& part : parts) out.values.insert(out.values.end(), part.values.begin(), part.values.end());
    return out;
  }

  static Image add(Image a, const Image& b) {
    for (std::size_t i = 0; i < a.values.size(); ++i) a.values[i] += b.values[i];
    return a;
  }

  /// Fine texel centre i lies at coarse coordinate (i + 0.5) / 4 - 0.5; values beyond the outermost centres repeat
  /// them.
  static Image upsample(const Image& x) {
    Image out(x.channels, 4 * x.height, 4 * x.width);
    const auto place = [](int i, int size, int& low, int& high, double& t) {
      const double position = std::max(0.0, (i + 0.5) / 4 - 0.5);
      low = static_cast<int>(position);
      high = std::min(low + 1, size - 1);
      t = position - low;
    };
    for (int y = 0; y < out.height; ++y) {
      for (int column = 0; column < out.width; ++column) {
        int y0, y1, x0, x1;
        double ty, tx;
        place(y, x.height, y0, y1, ty);
        place(column, x.width, x0, x1, tx);
        for (int c = 0; c < x.channels; ++c) {
          out.at(c, y, column) = (1 - ty) * ((1 - tx) * x.at(c, y0, x0) + tx * x.at(c, y0, x1)) +
                                 ty * ((1 - tx) * x.at(c, y1, x0) + tx * x.at(c, y1, x1));
        }
      }
    }
    return out;
  }

  Image residual_blocks(Image features) const {
    for (int d = 0; d < a_.blocks; ++d) {
      const std::string block = "block" + std::to_string(d);
      Image inner = convolve(features, block + "_first", 3);
      for (double& v : inner.values) v = std::max(v, 0.0);
      features = add(convolve(inner, block + "_second", 3), features);
    }
    return features;
  }

  Image prelu(Image x, const std::string& name) const {
    for (int c = 0; c < x.channels; ++c) {
      for (int i = 0; i < x.height * x.width; ++i) {
        double& v = x.at(c, i / x.width, i % x.width);
        if (v < 0) v *= value(name + "_slope", c);
      }
    }
    return x;
  }

  static Image shuffle(const Image& x, int scale) {
    const int square = scale * scale;
    Image out(x.channels / square, scale * x.height, scale * x.width);
    for (int c = 0; c < out.channels; ++c) {
      for (int y = 0; y < out.height; ++y) {
        for (int column = 0; column < out.width; ++column) {
          out.at(c, y, column) = x.at(square * c + scale * (y % scale) + column % scale, y / scale, column / scale);
        }
      }
    }
    return out;
  }

  Image condition(const Image& x) const {
    Image out(2 * kChannels, x.height, x.width);
    for (int c = 0; c < kChannels; ++c) {
      for (int y = 0; y < x.height; ++y) {
        for (int column = 0; column < x.width; ++column) {
          double sum = 0;
          int count = 0;
          for (int yy = std::max(0, y - 3); yy <= std::min(x.height - 1, y + 3); ++yy) {
            for (int xx = std::max(0, column - 3); xx <= std::min(x.width - 1, column + 3); ++xx) {
              sum += x.at(c, yy, xx), ++count;
            }
          }
          const double v = x.at(c, y, column);
          out.at(c, y, column) = (v - value("input_mean", c)) / value("input_deviation", c);
          out.at(kChannels + c, y, column) = (v - sum / count) / value("detail_deviation", c);
        }
      }
    }
    return out;
  }

  Architecture a_;
  std::map<std::string, std::vector<double>> values_;
  std::map<std::string, int> outputs_;
};

class NetworkVariants : public testing::TestWithParam<std::tuple<const char*, const char*, bool, const char*>> {
 protected:
  Architecture architecture() const {
    const auto& [upsampling, residual, conditioned, kind] = GetParam();
    return small(upsampling, residual, conditioned, "aligned", kind);
  }
};

TEST_P(NetworkVariants, AgreesWithPlainLoops) {
  const Network network = make_network(architecture());
  const auto x = example_input(1, 7, 9);
  const Image expected = Plain(network).forward(from_tensor(x));
  const Image actual = from_tensor(network.forward(x));
  ASSERT_EQ(actual.channels, kChannels);
  ASSERT_EQ(actual.height, 28);
  ASSERT_EQ(actual.width, 36);
  double worst = 0;
  for (std::size_t i = 0; i < actual.values.size(); ++i) {
    worst = std::max(worst, std::abs(actual.values[i] - expected.values[i]));
  }
  EXPECT_LT(worst, 1e-5);
}

TEST_P(NetworkVariants, ScriptIsTheSameFunction) {
  const Network network = make_network(architecture());
  auto module = network.to_script();
  const auto x = example_input(3, 5, 6);
  const auto difference = (module.forward({x}).toTensor() - network.forward(x)).abs().max().item<double>();
  EXPECT_LT(difference, 1e-5);
}

INSTANTIATE_TEST_SUITE_P(All, NetworkVariants,
                         testing::Combine(testing::Values("bilinear", "subpixel"), testing::Values("none", "bilinear"),
                                          testing::Bool(), testing::Values("mfsr", "srresnet")));

class ChenNetwork : public testing::Test {
 protected:
  const Network network_ = make_network(small("subpixel", "none", false, "aligned", "chen2018"));
  const torch::Tensor x_ = example_input(1, kMeshHeight, kMeshWidth);
};

TEST_F(ChenNetwork, AgreesWithPlainLoops) {
  const Image expected = Plain(network_).chen(from_tensor(x_));
  const Image actual = from_tensor(network_.forward(x_));
  ASSERT_EQ(actual.values.size(), 16 * static_cast<std::size_t>(x_.numel()));
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < expected.height; ++y) {
      for (int x = 0; x < expected.width; ++x) {
        worst = std::max(worst, std::abs(expected.at(c, y, x) - actual.at(c, y, x)));
      }
    }
  }
  EXPECT_LT(worst, 1e-5);
}

TEST_F(ChenNetwork, SeesPositionsAlone) {
  auto other = x_.clone();
  other.slice(1, 3, kChannels) += 0.3;
  EXPECT_TRUE(torch::equal(network_.forward(other).slice(1, 0, 3), network_.forward(x_).slice(1, 0, 3)));
}

TEST_F(ChenNetwork, ScriptIsTheSameFunction) {
  auto module = network_.to_script();
  const auto x = example_input(3, kMeshHeight, kMeshWidth);
  EXPECT_LT((module.forward({x}).toTensor() - network_.forward(x)).abs().max().item<double>(), 1e-5);
}

TEST(Network, OnlyTheRegisteredKindsAreMade) {
  for (const std::string& kind : architecture_kinds()) {
    EXPECT_GT(Network(small("subpixel", "none", false, "aligned", kind), 1).parameter_count(), 0) << kind;
  }
  EXPECT_THROW(Network(small("subpixel", "none", false, "aligned", "gan"), 1), Error);
  EXPECT_THROW(Network(small("bilinear", "none", false, "aligned", "chen2018"), 1), Error);
}

TEST(Network, PublishedSizesHaveTheExpectedNumberOfParameters) {
  const Network network(Architecture{}, 1);
  // Counted by hand from the figure: shallow, 16 blocks of 6 layers with fusion, global fusion, heads.
  const auto conv = [](std::int64_t in, std::int64_t out, std::int64_t k) { return in * out * k * k + out; };
  std::int64_t expected =
      conv(9, 64, 3) + conv(64, 64, 3) + conv(16 * 64, 64, 1) + conv(64, 64, 3) + 3 * conv(64, 3, 3);
  for (int layer = 0; layer < 6; ++layer) expected += 16 * conv(64 + 32 * layer, 32, 3);
  expected += 16 * conv(64 + 6 * 32, 64, 1);
  EXPECT_EQ(network.parameter_count(), expected);
}

TEST(Network, UntrainedResidualNetworkIsBilinearUpsampling) {
  for (const char* upsampling : {"bilinear", "subpixel"}) {
    const Network network(small(upsampling, "bilinear", true), 3);
    const auto x = example_input(2, 4, 5);
    EXPECT_LT((network.forward(x) - upsample_bilinear(x)).abs().max().item<double>(), 1e-7);
  }
}

TEST(Network, SeedDecidesTheWeights) {
  const auto weights = [](std::uint64_t seed) {
    return Network(small("bilinear", "none", false), seed).parameters()[0].second;
  };
  EXPECT_TRUE(torch::equal(weights(1), weights(1)));
  EXPECT_FALSE(torch::equal(weights(1), weights(2)));
}

TEST(Network, Bfloat16BodyStaysClose) {
  const Network network = make_network(small("subpixel", "bilinear", true));
  const auto x = example_input(1, 8, 8);
  const auto exact = network.forward(x), rounded = network.forward(x, torch::kBFloat16);
  EXPECT_EQ(rounded.scalar_type(), torch::kFloat32);
  const double detail = (exact - upsample_bilinear(x)).square().mean().sqrt().item<double>();
  EXPECT_LT((exact - rounded).square().mean().sqrt().item<double>(), 0.02 * detail);
  EXPECT_FALSE(torch::equal(exact, rounded));
}

TEST(Network, EveryParameterGetsAGradient) {
  const Network network = make_network(small("bilinear", "bilinear", true));
  network.forward(example_input(1, 6, 6)).square().sum().backward();
  for (const auto& [name, value] : network.parameters()) {
    ASSERT_TRUE(value.grad().defined()) << name;
    EXPECT_GT(value.grad().abs().max().item<double>(), 0) << name;
  }
}

TEST(Network, MeshResidualScriptsAreTheSameFunction) {
  for (const char* axes : {"aligned", "local"}) {
    const Network network = make_network(small("subpixel", "mesh", true, axes));
    auto module = network.to_script();
    const auto x = example_input(3, kMeshHeight, kMeshWidth);
    const auto expected = network.forward(x);
    EXPECT_LT((module.forward({x}).toTensor() - expected).abs().max().item<double>(), 1e-5) << axes;
    EXPECT_GT((expected - network.base_image(x)).abs().max().item<double>(), 1e-3) << axes;
  }
}

TEST(Network, BaseImageMixesVerticesThatTheImageGives) {
  const Network network = make_network(small("subpixel", "mesh", true));
  const MeshBase base = example_base();
  const auto x = example_input(1, kMeshHeight, kMeshWidth);
  const auto image = network.base_image(x);
  const int texels = kMeshHeight * kMeshWidth;
  for (const std::int64_t t : {0, 37, 200}) {
    double expected = 0.5;
    for (std::int64_t k = 0; k < 3; ++k) {
      const auto i = static_cast<std::size_t>(k * 16 * texels + t);
      for (int j = 0; j < kNear; ++j) {
        const auto near = static_cast<std::size_t>(base.corners[i] * kNear + j);
        expected += base.weights[i] * base.vertex_weights[near] *
                    (x[0][4].view({-1})[base.vertex_texels[near]].item<double>() - 0.5);
      }
    }
    EXPECT_NEAR(image[0][4].view({-1})[t].item<double>(), expected, 1e-5);
  }
}

/// Turning the cloth, its normals and velocities turns what a network with local axes adds, and changes nothing else.
TEST(Network, LocalAxesTurnWithTheCloth) {
  const Network network = make_network(small("subpixel", "mesh", true, "local"));
  const Normalization normalization = example_normalization();
  auto minimum = torch::empty({1, kChannels, 1, 1}), range = torch::empty({1, kChannels, 1, 1});
  for (std::int64_t c = 0; c < kChannels; ++c) {
    const auto i = static_cast<std::size_t>(c);
    minimum[0][c] = normalization.minimum[i];
    range[0][c] = normalization.maximum[i] - normalization.minimum[i];
  }
  const auto rest = torch::tensor(example_base().rest).view({1, 3, kMeshHeight, kMeshWidth});
  const double a = 0.7;
  const auto turn = torch::tensor({std::cos(a), -std::sin(a), 0.0, std::sin(a), std::cos(a), 0.0, 0.0, 0.0, 1.0})
                        .to(torch::kFloat32)
                        .view({3, 3});
  const auto rotate = [&](const torch::Tensor& v) { return torch::einsum("ij,njhw->nihw", {turn, v}); };
  const auto x = example_input(1, kMeshHeight, kMeshWidth);
  const auto physical = x * range + minimum;
  const auto turned = torch::cat(
      {rotate(physical.slice(1, 0, 3) + rest) - rest, rotate(physical.slice(1, 3, 6)), rotate(physical.slice(1, 6, 9))},
      1);
  const auto y = (turned - minimum) / range;
  const auto added = [&](const torch::Tensor& image) {
    return ((network.forward(image) - network.base_image(image)) * range).slice(1, 0, 3);
  };
  const auto expected = rotate(added(x));
  EXPECT_LT((added(y) - expected).abs().max().item<double>(), 1e-3 * expected.abs().max().item<double>());
}

TEST(Network, SenselessSizesAreRefused) {
  EXPECT_THROW(Network({0, 6, 32, 64, "bilinear", "none", "aligned", false}, 1), Error);
  EXPECT_THROW(Network({16, 6, 32, 100000, "bilinear", "none", "aligned", false}, 1), Error);
  EXPECT_THROW(Network({16, 6, 32, 64, "nearest", "none", "aligned", false}, 1), Error);
  Network network(small("bilinear", "bilinear", true), 1);
  Conditioning conditioning;
  conditioning.input_mean.assign(9, 0);
  conditioning.input_deviation.assign(9, 0);
  EXPECT_THROW(network.set_conditioning(conditioning), Error);
}

}  // namespace
}  // namespace pleat::superres
