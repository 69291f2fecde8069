// The networks of the registry against plain loops that share nothing with them but the weights, and their TorchScript
// twins.
#include "services/superres/networks/network.hpp"

#include <gtest/gtest.h>
#include <torch/script.h>

#include <cmath>
#include <map>

#include "common/base/error.hpp"
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

/// The small networks of example_network.hpp, as the papers draw them.
class Plain {
 public:
  explicit Plain(const Network& network) {
    for (const auto& [name, value] : network.parameters()) {
      const auto flat = value.detach().contiguous().view({-1});
      auto& target = values_[name];
      for (std::int64_t i = 0; i < flat.numel(); ++i) target.push_back(flat[i].item<double>());
      outputs_[name] = static_cast<int>(value.size(0));
    }
  }

  Image mfsr(const Image& x, bool subpixel) const {
    const Image shallow = convolve(x, "shallow0", 3);
    Image features = convolve(shallow, "shallow1", 3);
    std::vector<Image> blocks;
    for (int d = 0; d < kBlocks; ++d) {
      features = dense_block(features, "block" + std::to_string(d), kLayers);
      blocks.push_back(features);
    }
    return heads(add(convolve(convolve(join(blocks), "global0", 1), "global1", 3), shallow), subpixel);
  }

  Image unet(const Image& x, bool subpixel) const {
    const Image shallow = convolve(x, "shallow0", 3);
    Image features = convolve(shallow, "shallow1", 3);
    std::vector<Image> down;
    for (int level = 0; level < 2; ++level) {
      down.push_back(dense_block(features, "down" + std::to_string(level) + "_0", 2));
      features = halved(down.back());
    }
    features = dense_block(features, "down2_0", 2);
    for (int level = 1; level >= 0; --level) {
      const Image& beside = down[static_cast<std::size_t>(level)];
      const Image enlarged = resized(features, beside.height, beside.width);
      const Image joined = convolve(join({beside, enlarged}), "join" + std::to_string(level), 1);
      features = dense_block(add(joined, beside), "up" + std::to_string(level) + "_0", 2);
    }
    return heads(add(convolve(features, "global1", 3), shallow), subpixel);
  }

  Image srresnet(const Image& x, bool subpixel) const {
    const Image shallow = convolve(x, "shallow0", 3);
    return heads(add(convolve(residual_blocks(convolve(shallow, "shallow1", 3)), "global1", 3), shallow), subpixel);
  }

  Image chen2018(const Image& x) const {
    const Image shallow = prelu(convolve(x, "shallow0", 3), "shallow0");
    Image features = add(convolve(residual_blocks(shallow), "global1", 3), shallow);
    for (const char* stage : {"stage0", "stage1"}) features = shuffle(prelu(convolve(features, stage, 3), stage), 2);
    return convolve(features, "last", 3);
  }

  Image tokens(const Image& x) const {
    Image tokens = convolve(x, "tokens", 1);
    for (int b = 0; b < kBlocks; ++b) {
      const std::string block = "block" + std::to_string(b);
      const Image spatial = seen(tokens, block + "_spatial", false), temporal = seen(tokens, block + "_temporal", true);
      const Image both = add(spatial, temporal);
      const Image inner = rectified(by_frames(both, block + "_hidden"));
      tokens = normalized(add(by_frames(inner, block + "_out"), both), block + "_norm");
    }
    return shuffle(convolve(rectified(convolve(join({tokens, x}), "answer_hidden", 1)), "answer", 1), 4);
  }

 private:
  static constexpr int kBlocks = 2, kLayers = 3;
  static constexpr int kFrames = 3, kHeads = 2;

  Image dense_block(const Image& features, const std::string& name, int layers) const {
    Image stack = features;
    for (int c = 0; c < layers; ++c) {
      stack = join({stack, rectified(convolve(stack, name + "_dense" + std::to_string(c), 3))});
    }
    return add(convolve(stack, name + "_fusion", 1), features);
  }

  /// Means over 2 x 2; at an odd end over what there is.
  static Image halved(const Image& x) {
    Image out(x.channels, (x.height + 1) / 2, (x.width + 1) / 2);
    for (int c = 0; c < x.channels; ++c) {
      for (int y = 0; y < out.height; ++y) {
        for (int column = 0; column < out.width; ++column) {
          double sum = 0;
          int count = 0;
          for (int yy = 2 * y; yy < std::min(2 * y + 2, x.height); ++yy) {
            for (int xx = 2 * column; xx < std::min(2 * column + 2, x.width); ++xx, ++count) sum += x.at(c, yy, xx);
          }
          out.at(c, y, column) = sum / count;
        }
      }
    }
    return out;
  }

  static Image rectified(Image x) {
    for (double& v : x.values) v = std::max(v, 0.0);
    return x;
  }

  static Image frame(const Image& x, int t) {
    Image part(x.channels / kFrames, x.height, x.width);
    std::copy_n(x.values.begin() + static_cast<std::ptrdiff_t>(t * part.values.size()), part.values.size(),
                part.values.begin());
    return part;
  }

  Image by_frames(const Image& x, const std::string& name) const {
    std::vector<Image> parts;
    for (int t = 0; t < kFrames; ++t) parts.push_back(convolve(frame(x, t), name, 1));
    return join(parts);
  }

  Image normalized(const Image& x, const std::string& name) const {
    std::vector<Image> parts;
    for (int t = 0; t < kFrames; ++t) {
      Image part = frame(x, t);
      for (int i = 0; i < part.height * part.width; ++i) {
        const auto at = [&](int c) -> double& { return part.at(c, i / part.width, i % part.width); };
        double mean = 0, square = 0;
        for (int c = 0; c < part.channels; ++c) mean += at(c) / part.channels;
        for (int c = 0; c < part.channels; ++c) square += (at(c) - mean) * (at(c) - mean) / part.channels;
        for (int c = 0; c < part.channels; ++c) {
          at(c) = (at(c) - mean) / std::sqrt(square + 1e-5) * value(name + "_weight", c) + value(name + "_bias", c);
        }
      }
      parts.push_back(part);
    }
    return join(parts);
  }

  Image seen(const Image& x, const std::string& name, bool over_frames) const {
    const Image parts = by_frames(x, name + "_parts");
    const int features = x.channels / kFrames, width = features / kHeads, places = x.height * x.width;
    Image mixed(x.channels, x.height, x.width);
    // which: 0 query, 1 key, 2 value
    const auto part = [&](int which, int t, int head, int c, int place) {
      return parts.at((3 * t + which) * features + head * width + c, place / x.width, place % x.width);
    };
    for (int head = 0; head < kHeads; ++head) {
      for (int t = 0; t < kFrames; ++t) {
        for (int place = 0; place < places; ++place) {
          std::vector<double> weights;
          double sum = 0;
          for (int other = 0; other < (over_frames ? kFrames : places); ++other) {
            double dot = 0;
            for (int c = 0; c < width; ++c) {
              dot += part(0, t, head, c, place) *
                     (over_frames ? part(1, other, head, c, place) : part(1, t, head, c, other));
            }
            weights.push_back(std::exp(dot / std::sqrt(static_cast<double>(width))));
            sum += weights.back();
          }
          for (int c = 0; c < width; ++c) {
            double& target = mixed.at(t * features + head * width + c, place / x.width, place % x.width);
            for (int other = 0; other < static_cast<int>(weights.size()); ++other) {
              target += weights[static_cast<std::size_t>(other)] / sum *
                        (over_frames ? part(2, other, head, c, place) : part(2, t, head, c, other));
            }
          }
        }
      }
    }
    return normalized(add(by_frames(mixed, name + "_mix"), x), name + "_norm");
  }

  Image heads(const Image& features, bool subpixel) const {
    return subpixel ? shuffle(convolve(features, "heads", 3), 4) : convolve(upsample(features), "heads", 3);
  }

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

  static Image upsample(const Image& x) { return resized(x, 4 * x.height, 4 * x.width); }

  /// Texel centres lie at (i + 0.5) / size; values beyond the outermost centres repeat them.
  static Image resized(const Image& x, int height, int width) {
    Image out(x.channels, height, width);
    const auto place = [](int i, int from, int to, int& low, int& high, double& t) {
      const double position = std::max(0.0, (i + 0.5) * from / to - 0.5);
      low = static_cast<int>(position);
      high = std::min(low + 1, from - 1);
      t = position - low;
    };
    for (int y = 0; y < out.height; ++y) {
      for (int column = 0; column < out.width; ++column) {
        int y0, y1, x0, x1;
        double ty, tx;
        place(y, x.height, height, y0, y1, ty);
        place(column, x.width, width, x0, x1, tx);
        for (int c = 0; c < x.channels; ++c) {
          out.at(c, y, column) = (1 - ty) * ((1 - tx) * x.at(c, y0, x0) + tx * x.at(c, y0, x1)) +
                                 ty * ((1 - tx) * x.at(c, y1, x0) + tx * x.at(c, y1, x1));
        }
      }
    }
    return out;
  }

  Image residual_blocks(Image features) const {
    for (int d = 0; d < kBlocks; ++d) {
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

  std::map<std::string, std::vector<double>> values_;
  std::map<std::string, int> outputs_;
};

double difference(const Image& a, const Image& b) {
  EXPECT_EQ(a.channels, b.channels);
  EXPECT_EQ(a.height, b.height);
  EXPECT_EQ(a.width, b.width);
  double worst = 0;
  for (std::size_t i = 0; i < std::min(a.values.size(), b.values.size()); ++i) {
    worst = std::max(worst, std::abs(a.values[i] - b.values[i]));
  }
  return worst;
}

TEST(Network, AgreesWithPlainLoops) {
  const auto x = example_input(1, 7, 7, 9);
  const Image image = from_tensor(x);
  for (const bool subpixel : {false, true}) {
    const char* upsampling = subpixel ? "subpixel" : "bilinear";
    const Network mfsr = make_network(small_mfsr(upsampling)), srresnet = make_network(small_srresnet(upsampling));
    EXPECT_LT(difference(from_tensor(mfsr.forward(x)), Plain(mfsr).mfsr(image, subpixel)), 1e-5) << upsampling;
    EXPECT_LT(difference(from_tensor(srresnet.forward(x)), Plain(srresnet).srresnet(image, subpixel)), 1e-5)
        << upsampling;
  }
  for (const bool subpixel : {false, true}) {
    const Network unet = make_network(small_unet(subpixel ? "subpixel" : "bilinear"));
    EXPECT_LT(difference(from_tensor(unet.forward(x)), Plain(unet).unet(image, subpixel)), 1e-5) << subpixel;
  }
  const Network chen = make_network(describe({"chen2018", R"({"blocks": 2, "features": 6})"}, {7, 3, 4, false}));
  EXPECT_LT(difference(from_tensor(chen.forward(x)), Plain(chen).chen2018(image)), 1e-5);
  const Network tokens = make_network(small_tokens());
  EXPECT_LT(difference(from_tensor(tokens.forward(x)), Plain(tokens).tokens(image)), 1e-5);
}

TEST(Network, TokensAreExactAndTheirScriptIsTheSame) {
  for (const char* modules :
       {"", R"(, "spatial": false)", R"(, "temporal": false)", R"(, "spatial": false, "temporal": false)"}) {
    const Network network = make_network(small_tokens(modules));
    const auto x = example_input(2, 7, 1, 6), expected = network.forward(x);
    EXPECT_EQ(expected.sizes(), (torch::IntArrayRef{2, 3, 4, 24}));
    EXPECT_LT((network.to_script().forward({x}).toTensor() - expected).abs().max().item<double>(), 1e-5) << modules;
    EXPECT_TRUE(torch::equal(network.forward(x, torch::kBFloat16), expected)) << modules;
    EXPECT_FALSE(kernels::Trainable::supports(network.description()));
  }
  EXPECT_THROW(describe({"tokens", R"({"features": 6, "heads": 4})"}, {7, 3, 4, false, 3}), Error);
}

TEST(Network, EveryParameterOfTokensGetsItsGradient) {
  const Network network = make_network(small_tokens());
  const auto x = example_input(1, 7, 1, 5);
  const auto loss = [&] { return network.forward(x).square().sum(); };
  loss().backward();
  const torch::NoGradGuard no_grad;
  for (const auto& [name, value] : network.parameters()) {
    ASSERT_TRUE(value.grad().defined()) << name;
    auto flat = value.view({-1});
    for (const std::int64_t i : {std::int64_t{0}, flat.numel() - 1}) {
      const float before = flat[i].item<float>(), step = 1e-2F;
      flat[i] = before + step;
      const double above = loss().item<double>();
      flat[i] = before - step;
      const double below = loss().item<double>();
      flat[i] = before;
      const double gradient = value.grad().view({-1})[i].item<double>();
      EXPECT_NEAR((above - below) / (2 * static_cast<double>(step)), gradient, 2e-2 * (1 + std::abs(gradient))) << name;
    }
  }
}

class NetworkVariants : public testing::TestWithParam<Description> {};

TEST_P(NetworkVariants, ScriptIsTheSameFunction) {
  const Network network = make_network(GetParam());
  auto module = network.to_script();
  const auto x = example_input(3, GetParam().inputs, 5, 6), expected = network.forward(x);
  EXPECT_LT((module.forward({x}).toTensor() - expected).abs().max().item<double>(), 1e-5);

  // In bfloat16, too, where every layer has the type of its weights.
  const auto exact = network.float32_parameters();
  for (const auto& entry : module.named_parameters()) {
    auto value = entry.value;
    if (std::none_of(exact.begin(), exact.end(), [&](const auto& name) { return entry.name.rfind(name, 0) == 0; })) {
      value.set_data(value.to(torch::kBFloat16));
    }
  }
  const auto rounded = module.forward({x}).toTensor();
  EXPECT_EQ(rounded.scalar_type(), torch::kFloat32);
  EXPECT_TRUE(torch::equal(rounded, network.forward(x, torch::kBFloat16)));
  const double error = (rounded - expected).square().mean().sqrt().item<double>();
  EXPECT_LT(error, 0.03 * expected.square().mean().sqrt().item<double>());
  EXPECT_GT(error, 0);
}

TEST_P(NetworkVariants, EveryParameterGetsAGradient) {
  const Network network = make_network(GetParam());
  network.forward(example_input(1, GetParam().inputs, 6, 6)).square().sum().backward();
  for (const auto& [name, value] : network.parameters()) {
    ASSERT_TRUE(value.grad().defined()) << name;
    EXPECT_GT(value.grad().abs().max().item<double>(), 0) << name;
  }
}

INSTANTIATE_TEST_SUITE_P(All, NetworkVariants,
                         testing::Values(small_mfsr("subpixel"), small_mfsr("bilinear"), small_srresnet("subpixel"),
                                         small_srresnet("bilinear"), small_unet("subpixel"), small_unet("bilinear"),
                                         several_scales(),
                                         describe({"chen2018", R"({"blocks": 2, "features": 6})"}, {3, 3, 4, false})));

TEST(Network, PublishedSizesHaveTheExpectedNumberOfParameters) {
  const Network network(describe({}, {9, 9, 4, false}), 1);
  // Counted by hand from the figure: shallow, 16 blocks of 6 layers with fusion, global fusion, heads.
  const auto conv = [](std::int64_t in, std::int64_t out, std::int64_t k) { return in * out * k * k + out; };
  std::int64_t expected =
      conv(9, 64, 3) + conv(64, 64, 3) + conv(16 * 64, 64, 1) + conv(64, 64, 3) + 3 * conv(64, 3, 3);
  for (int layer = 0; layer < 6; ++layer) expected += 16 * conv(64 + 32 * layer, 32, 3);
  expected += 16 * conv(64 + 6 * 32, 64, 1);
  EXPECT_EQ(network.parameter_count(), expected);
}

TEST(Network, UntrainedDetailIsZero) {
  for (const char* options : {R"({"blocks": 1})", R"({"blocks": 1, "upsampling": "subpixel"})"}) {
    const Network network(describe({"mfsr", options}, {7, 3, 4, true}), 3);
    EXPECT_EQ(network.forward(example_input(2, 7, 4, 5)).abs().max().item<double>(), 0);
  }
}

TEST(Network, SeedDecidesTheWeights) {
  const auto weights = [](std::uint64_t seed) { return Network(small_mfsr("bilinear"), seed).parameters()[0].second; };
  EXPECT_TRUE(torch::equal(weights(1), weights(1)));
  EXPECT_FALSE(torch::equal(weights(1), weights(2)));
}

}  // namespace
}  // namespace pleat::superres
